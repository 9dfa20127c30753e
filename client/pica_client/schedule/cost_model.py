"""What decoding and drawing cost on this machine, learned while they are done. Pure.

Decoding: the median of the last measurements of each (model, level, parts); what has not been
measured yet costs what is expected of it, times what this machine takes over what was expected of
all others. Drawing: intercept + triangles + shaded pixels, fitted to the last few hundred frames,
each fading out, and held to the expected where a scene that never changes cannot tell the three
apart.

Robust by construction: a single spike (a page fault, another process) never reaches an estimate,
since what is far from the median of itself and a few before it counts as that median; a change
that lasts is learned after a few. Nothing is ever negative.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from statistics import median

import numpy as np

from pica_client.decode.request import Parts
from pica_core.types import Float64Array

EXPECTED_DECODE_S: Mapping[Parts, Mapping[int, float]] = {
    "both": {64: 0.5e-3, 128: 1.7e-3, 256: 2.9e-3},
    "expression": {64: 0.3e-3, 128: 0.9e-3, 256: 1.5e-3},
}
"""Seconds on one thread, uploads included (measured: the fastest of 600 decodes of block G on a
busy machine of two cores). Only their proportions matter once one decode has been measured. Other
levels scale with their texels."""
WINDOW = 9
"""Measurements of one kind that a median is taken of (chosen: four bad ones do no harm)."""
GUARD = 5
"""Frames whose median says what is usual now."""
SPIKE = 3.0
"""A frame this many times longer or shorter than usual counts as a usual one."""
FADE = 0.98
"""What a drawn frame still weighs after the next (chosen: the last fifty, two seconds, count)."""
PRIOR_WEIGHT = 0.003
"""Pull of the expected, as a share of what is known of a coefficient (chosen: it decides where all
frames are alike, and moves what frames do tell by a few parts in a thousand)."""
MIN_SECONDS, MAX_SECONDS = 1e-7, 10.0
"""Shorter is no measurement, because clocks tick; longer is a machine that slept."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DrawCost:
    """The three parts of drawing a frame; seconds. The defaults are expected before any frame was
    measured: about what software GL takes on two cores (chosen: some frames correct them).
    """

    frame_s: float = 1.5e-3
    """Whatever the frame shows."""
    triangle_s: float = 60e-9
    """Per triangle that goes through the vertex stage."""
    pixel_s: float = 60e-9
    """Per pixel that the pixel decoder runs on."""

    def seconds(self, num_triangles: float, shaded_px: float) -> float:
        """What a frame is likely to take to draw."""
        return self.frame_s + self.triangle_s * num_triangles + self.pixel_s * shaded_px


class CostModel:
    """Learned costs; see the module for how.

    Attributes:
        draw: The parts of drawing as they are estimated now.
    """

    def __init__(self) -> None:
        self.draw = expected = DrawCost()
        self._windows: dict[tuple[str, int, Parts], deque[float]] = {}
        self._decode_s: dict[tuple[str, int, Parts], float] = {}
        self._slowness = 1.0
        # A coefficient is fitted as a multiple of what is expected: all three are near 1 then.
        self._scale = np.array([expected.frame_s, expected.triangle_s, expected.pixel_s])
        self._gram = np.zeros((3, 3))
        self._sums = np.zeros(3)
        self._ratios: deque[float] = deque(maxlen=GUARD)

    def observe_decode(self, model: str, level: int, parts: Parts, seconds: float) -> None:
        """Take the computing time of one decode and its upload into account, without waiting;
        nonsense is ignored. `model` names what has costs of its own."""
        if not MIN_SECONDS <= seconds <= MAX_SECONDS:
            return
        key = model, level, parts
        window = self._windows.setdefault(key, deque(maxlen=WINDOW))
        window.append(seconds)
        self._decode_s[key] = median(window)
        self._slowness = median(
            found_s / expected_decode_s(level, parts)
            for (_, level, parts), found_s in self._decode_s.items()
        )

    def decode_s(self, model: str, level: int, parts: Parts) -> float:
        """What a decode and its upload are likely to take, seconds."""
        known_s = self._decode_s.get((model, level, parts))
        return self._slowness * expected_decode_s(level, parts) if known_s is None else known_s

    def observe_draw(self, num_triangles: float, shaded_px: float, seconds: float) -> None:
        """Take the time of one drawn frame into account, read-back or buffer swap not included."""
        is_plausible = 0 <= num_triangles < 1e9 and 0 <= shaded_px < 1e9
        if not (is_plausible and MIN_SECONDS <= seconds <= MAX_SECONDS):
            return
        expected_s = self.draw.seconds(num_triangles, shaded_px) or MIN_SECONDS
        self._ratios.append(seconds / expected_s)
        usual_s = median(self._ratios) * expected_s
        if not usual_s / SPIKE <= seconds <= usual_s * SPIKE:
            seconds = usual_s
        # Relative errors count, seen from the expected: what a frame weighs must not change with
        # what the machine is found to be.
        row = self._scale * (1.0, num_triangles, shaded_px)
        usual = float(row.sum())
        row /= usual
        self._gram = FADE * self._gram + np.outer(row, row)
        self._sums = FADE * self._sums + row * (seconds / usual)
        frame_s, triangle_s, pixel_s = (self._multiples() * self._scale).tolist()
        self.draw = DrawCost(frame_s=frame_s, triangle_s=triangle_s, pixel_s=pixel_s)

    def _multiples(self) -> Float64Array:
        """Least squares with a weak pull of each towards 1; what would be negative is 0."""
        pull = PRIOR_WEIGHT * np.diag(self._gram) + 1e-12
        gram, sums = self._gram + np.diag(pull), self._sums + pull
        found = np.zeros(3)
        kept = [0, 1, 2]
        while kept:
            part = np.linalg.solve(gram[np.ix_(kept, kept)], sums[kept])
            if part.min() >= 0:
                found[kept] = part
                break
            del kept[int(part.argmin())]
        return found


@cache
def expected_decode_s(level: int, parts: Parts) -> float:
    """What a decode takes as far as one can tell beforehand, seconds."""
    table = EXPECTED_DECODE_S[parts]
    nearest = min(table, key=lambda known: abs(math.log(known / level)))
    return table[nearest] * (level / nearest) ** 2
