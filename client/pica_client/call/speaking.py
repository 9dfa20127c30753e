"""Who is speaking, from how a jaw moves: a hint for the eye, without any sound. Pure.

A receiver has no blendshapes, only latents. But the avatar's file holds the encoder that made them,
and so says which way the latent goes when the jaw opens: `JawReader` fits, once per avatar, the
linear function of the latent that tells jawOpen best over expressions in which the jaw and one
other shape move. `SpeakingMeter` takes its values: a jaw that goes to and fro speaks; one that
opens once and stays (a yawn, a gasp) does not, and neither does one that trembles with the coder's
noise.

    meter = SpeakingMeter()
    meter.receive(reader.jaw_open(latent), now)
    meter.is_speaking(now)
"""

from collections import deque
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.types import FloatArray

PROBE_JAW = (0.0, 0.2, 0.4, 0.7, 1.0)
PROBE_OTHER = (0.0, 0.5)
"""Values of jawOpen and of each other shape over which the reader is fitted."""
RIDGE = 1e-2
"""Ridge of the fit, relative to the mean square of the latents: where two functions tell the jaw
equally well, the smaller one is less easily disturbed (chosen: of 1e-5 to 1e-2 the one that errs
least while the shipped avatars talk)."""

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
        probes = _probes()
        latents = ExpressionEncoder(avatar).encode(probes).reshape(len(probes), -1)
        rows = latents.astype(np.float64)
        self._rest = rows.mean(axis=0)
        jaw = probes[:, ARKIT_INDEX["jawOpen"]].astype(np.float64)
        self._rest_jaw = float(jaw.mean())
        centred = rows - self._rest
        # Ridge regression in its dual form: fewer probes than would make the primal well-posed.
        gram = np.matmul(centred, centred.T)
        ridge = RIDGE * float(np.trace(gram)) / len(probes) + 1e-12
        solved = np.linalg.solve(gram + ridge * np.eye(len(probes)), jaw - self._rest_jaw)
        self._weights: npt.NDArray[np.float64] = np.matmul(centred.T, solved)

    def jaw_open(self, latent: FloatArray) -> float:
        """How far the jaw is open, about 0 to 1; no number where nothing can be read, as of a
        latent that is not float32 ``[8, 8, 4]``."""
        if latent.size != self._rest.size:
            return float("nan")
        away = latent.reshape(-1).astype(np.float64) - self._rest
        return self._rest_jaw + float(np.dot(away, self._weights))


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


def _probes() -> FloatArray:
    """Expressions to fit over, float32 ``[N, 52]``."""
    rows = []
    for jaw in PROBE_JAW:
        for other in range(NUM_ARKIT):
            for value in PROBE_OTHER:
                if other == ARKIT_INDEX["jawOpen"] or (value == 0 and other > 0):
                    continue
                row = np.zeros(NUM_ARKIT, np.float32)
                row[other] = value
                row[ARKIT_INDEX["jawOpen"]] = jaw
                rows.append(row)
    return np.stack(rows)
