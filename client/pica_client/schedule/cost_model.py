"""What decoding and drawing cost on this machine, learned while they are done. Pure.

Decoding: the median of the last measurements of each (model, level, parts); a level that has not
been measured yet costs what is expected of it, times what this machine takes over what was
expected where it has been. Drawing: intercept + triangles + shaded pixels, fitted to the last few
hundred frames, each fading out, and held to the expected where a scene that never changes cannot
tell the three apart.

Robust by construction: a single spike (a page fault, another process) never reaches an estimate,
since what is far from the median of itself and a few before it counts as that median; a change
that lasts is learned after a few. Nothing is ever negative. A finer level is never taken to be
cheaper than a coarser one, nor both maps than one of them.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median

import numpy as np
import numpy.typing as npt

from pica_client.decode.request import Parts

EXPECTED_DECODE_S: Mapping[Parts, Mapping[int, float]] = {
    "both": {64: 0.5e-3, 128: 1.6e-3, 256: 2.5e-3},
    "expression": {64: 0.3e-3, 128: 0.8e-3, 256: 1.3e-3},
}
"""Seconds on one thread (measured: the fastest of 600 decodes of block G on a busy machine of two
cores). Only their proportions matter once one decode has been measured. Other levels scale with
their texels."""
WINDOW = 9
"""Measurements of one kind that a median is taken of (chosen: four bad ones do no harm)."""
GUARD = 5
"""Frames whose median says what is usual now."""
SPIKE = 3.0
"""A frame this many times longer or shorter than usual counts as a usual one."""
MAX_MODELS = 64
"""Kinds of model with measurements of their own; drops the oldest."""
FADE = 0.98
"""What a drawn frame still weighs after the next (chosen: the last fifty, two seconds, count)."""
PRIOR_WEIGHT = 0.003
"""Pull of the expected, as a share of what is known of a coefficient (chosen: it decides where all
frames are alike, and moves what frames do tell by a few parts in a thousand)."""
MIN_SECONDS = 1e-7
"""Shorter is no measurement: clocks tick."""
MAX_SECONDS = 10.0
"""Longer is a machine that slept."""
UPLOAD_S_PER_TEXEL = 3e-9
"""Seconds that uploading a texel of one map is expected to take."""


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
    """Learned costs; see the module for how."""

    def __init__(self) -> None:
        self._decodes: dict[tuple[str, int, Parts], deque[float]] = {}
        self._uploads: dict[tuple[int, Parts], deque[float]] = {}
        self._known: dict[tuple[str, int, Parts], float] = {}
        self._fit = _LineFit(DrawCost())

    @property
    def draw(self) -> DrawCost:
        """The parts of drawing as they are estimated now."""
        return self._fit.cost

    def observe_decode(self, model: str, level: int, parts: Parts, seconds: float) -> None:
        """Take the computing time of one decode into account, without waiting; nonsense is ignored.
        `model` names what has costs of its own."""
        if _is_plausible(seconds):
            if (model, level, parts) not in self._decodes and len(self._decodes) >= MAX_MODELS:
                del self._decodes[next(iter(self._decodes))]
            self._decodes.setdefault((model, level, parts), deque(maxlen=WINDOW)).append(seconds)
            self._known.clear()

    def observe_upload(self, level: int, parts: Parts, seconds: float) -> None:
        """Take the time to hand maps to the GPU into account."""
        if _is_plausible(seconds):
            self._uploads.setdefault((level, parts), deque(maxlen=WINDOW)).append(seconds)
            self._known.clear()

    def observe_draw(self, num_triangles: float, shaded_px: float, seconds: float) -> None:
        """Take the time of one drawn frame into account, read-back or buffer swap not included."""
        if _is_plausible(seconds) and 0 <= num_triangles < 1e9 and 0 <= shaded_px < 1e9:
            self._fit.receive(num_triangles, shaded_px, seconds)

    def decode_s(self, model: str, level: int, parts: Parts) -> float:
        """What a decode and its upload are likely to take, seconds."""
        key = (model, level, parts)
        if key in self._known:
            return self._known[key]
        machine = self._machine_factor(model)
        coarser = {level} | {
            other for known, other, _ in self._decodes if known == model and other < level
        }
        kinds: tuple[Parts, ...] = ("both", "expression") if parts == "both" else ("expression",)
        self._known[key] = max(
            self._single_s(model, other, kind, machine) for other in coarser for kind in kinds
        )
        return self._known[key]

    def _single_s(self, model: str, level: int, parts: Parts, machine: float) -> float:
        measured = self._decodes.get((model, level, parts))
        decode_s = median(measured) if measured else machine * expected_decode_s(level, parts)
        uploads = self._uploads.get((level, parts))
        if uploads:
            return decode_s + median(uploads)
        num_maps = 2 if parts == "both" else 1
        return decode_s + num_maps * level * level * UPLOAD_S_PER_TEXEL

    def _machine_factor(self, model: str) -> float:
        """How much longer than expected decodes take here: of this model, else of any."""
        ratios = [
            (known == model, median(seconds) / expected_decode_s(level, parts))
            for (known, level, parts), seconds in self._decodes.items()
        ]
        own = [ratio for is_own, ratio in ratios if is_own]
        return median(own or [ratio for _, ratio in ratios] or [1.0])


def expected_decode_s(level: int, parts: Parts) -> float:
    """What a decode takes as far as one can tell beforehand, seconds."""
    table = EXPECTED_DECODE_S[parts]
    nearest = min(table, key=lambda known: abs(math.log(known / level)))
    return table[nearest] * (level / nearest) ** 2


def _is_plausible(seconds: float) -> bool:
    return MIN_SECONDS <= seconds <= MAX_SECONDS


class _LineFit:
    """Fading least squares with three coefficients that may not be negative."""

    def __init__(self, prior: DrawCost) -> None:
        self.cost = prior
        # A coefficient is fitted as a multiple of its prior: all three are near 1 then.
        self._scale = np.array([prior.frame_s, prior.triangle_s, prior.pixel_s])
        self._gram = np.zeros((3, 3))
        self._sums = np.zeros(3)
        self._ratios: deque[float] = deque(maxlen=GUARD)

    def receive(self, num_triangles: float, shaded_px: float, seconds: float) -> None:
        """Take one frame, unless it stands alone."""
        expected_s = self.cost.seconds(num_triangles, shaded_px) or MIN_SECONDS
        self._ratios.append(seconds / expected_s)
        usual_s = median(self._ratios) * expected_s
        if not usual_s / SPIKE <= seconds <= usual_s * SPIKE:
            seconds = usual_s
        # Relative errors count, seen from the prior: what a frame weighs must not change with what
        # the machine is found to be.
        row = self._scale * (1.0, num_triangles, shaded_px)
        usual = float(row.sum())
        row /= usual
        self._gram = FADE * self._gram + np.outer(row, row)
        self._sums = FADE * self._sums + row * (seconds / usual)
        frame_s, triangle_s, pixel_s = (self._multiples() * self._scale).tolist()
        self.cost = DrawCost(frame_s=frame_s, triangle_s=triangle_s, pixel_s=pixel_s)

    def _multiples(self) -> npt.NDArray[np.float64]:
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
