"""Who is speaking, from how a jaw moves: a hint for the eye, without any sound. Pure.

A receiver has no blendshapes, only latents. But the avatar's file holds the encoder that made them,
and so says which way the latent goes when the jaw opens, or any other shape moves: `JawReader`
tells how far it went that way (off by 0.002 in the mean while the shipped avatars talk; by 0.01 to
0.04 where only the jaw's way is looked at, since others lie along it). `SpeakingMeter` takes its
values: a jaw that goes to and fro speaks; one that opens once and stays (a yawn, a gasp) does not,
and neither does one that trembles with the coder's noise.

    meter = SpeakingMeter()
    meter.receive(reader.jaw_open(latent), now)
    meter.is_speaking(now)
"""

from collections import deque
from itertools import pairwise

import numpy as np

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.types import FloatArray

RIDGE = 0.01
"""How much what shapes do is held towards nothing, as a share of what the jaw does (chosen: errors
are as without, and a coder's noise weighs a tenth more than in the jaw's way alone)."""
WINDOW_S = 1.2
"""Time over which a jaw is watched (chosen: three syllables)."""
DEAD_BAND = 0.02
"""Movement that is not seen as such, in units of jawOpen: what quantisation leaves (chosen)."""
SPEAKING_TRAVEL = 0.25
"""Way to and fro in a window, in units of jawOpen, from which on a person counts as speaking
(chosen between the shipped performances that talk and that listen; see the tests)."""
HOLD_S = 0.5
"""How long the hint stays after it: pauses between words are speech."""
MAX_SAMPLES = 300
"""Kept of a window; drops the oldest."""


class JawReader:
    """Reads how far the jaw is open out of one avatar's latents."""

    def __init__(self, avatar: Avatar) -> None:
        each_shape = np.eye(NUM_ARKIT + 1, NUM_ARKIT, -1, np.float32)
        latents = ExpressionEncoder(avatar).encode(each_shape).reshape(len(each_shape), -1)
        self._shut, *ways = latents.astype(np.float64)
        # What all shapes do at once, as a sum of what each does alone; held towards none of any, so
        # that shapes that look alike are not told apart by what a coder leaves off.
        shapes, jaw = np.array(ways) - self._shut, ARKIT_INDEX["jawOpen"]
        gram = np.matmul(shapes, shapes.T)
        pull = RIDGE * gram[jaw, jaw] + 1e-12
        self._weights = np.linalg.solve(gram + pull * np.eye(NUM_ARKIT), shapes)[jaw]

    def jaw_open(self, latent: FloatArray) -> float:
        """How far the jaw is open, about 0 to 1; no number where nothing can be read, as of a
        latent that is not float32 ``[8, 8, 4]``."""
        if latent.size != self._shut.size:
            return float("nan")
        return float(np.dot(latent.reshape(-1) - self._shut, self._weights))


class SpeakingMeter:
    """Watches one jaw."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque(maxlen=MAX_SAMPLES)
        self._followed: float | None = None
        self._spoke_s = -np.inf

    def receive(self, jaw_open: float, now: float) -> None:
        """Take how far the jaw is open at `now`, seconds."""
        if not np.isfinite(jaw_open):
            return
        if self._followed is None:
            self._followed = jaw_open
        # Follows like a lever with play: trembling within the dead band does not move it.
        self._followed = min(max(self._followed, jaw_open - DEAD_BAND), jaw_open + DEAD_BAND)
        self._samples.append((now, self._followed))
        while self._samples[0][0] < now - WINDOW_S:
            self._samples.popleft()
        if self._travel() >= SPEAKING_TRAVEL:
            self._spoke_s = now

    def is_speaking(self, now: float) -> bool:
        """Whether to show this person as speaking."""
        return bool(now - self._spoke_s <= HOLD_S)

    def _travel(self) -> float:
        """The way that the jaw went beyond what led it from the first place to the last."""
        places = [place for _, place in self._samples]
        way = sum(abs(after - before) for before, after in pairwise(places))
        return way - abs(places[-1] - places[0])
