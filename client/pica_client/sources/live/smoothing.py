"""Trackers tremble: a One-Euro filter for each region of the face.

Casiez, Roussel and Vogel, "1 € Filter", CHI 2012: a low-pass whose cutoff rises with the speed of
what it filters. At rest it holds still; a fast movement comes through almost as it is. Cutoffs are
chosen so that blinks and gaze stay raw, the mouth nearly so, and brows and head rest.
"""

from typing import Final

import numpy as np

from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES
from pica_core.types import BoolArray, Float64Array, FloatArray

DERIVATIVE_CUTOFF_HZ: Final = 1.0
REGIONS: Final[dict[tuple[str, ...], tuple[float, float]]] = {
    ("eyeBlink", "eyeLook"): (12.0, 20.0),
    ("jaw", "mouth", "tongue"): (5.0, 6.0),
    ("eye", "brow", "cheek", "nose"): (2.5, 3.0),
}
"""Least cutoff in hertz, and what a unit a second adds to it, by how the names begin."""
HEAD: Final = (2.0, 4.0)
"""The same for the rotation vector of the head, radians."""
OFFSET: Final = (2.0, 20.0)
"""The same for the head's offset from its seat, metres."""
BLINKS: Final = (ARKIT_INDEX["eyeBlinkLeft"], ARKIT_INDEX["eyeBlinkRight"])
GAZE: Final[BoolArray] = np.array([name.startswith("eyeLook") for name in ARKIT_NAMES])
CLOSED: Final = 0.5
"""Lids that are both this far down hide where the eyes look, and trackers guess it."""


def _of_shape(name: str) -> tuple[float, float]:
    return next(each for starts, each in REGIONS.items() if name.startswith(starts))


_CUTOFF_HZ, _SPEED_FACTOR = np.array([*map(_of_shape, ARKIT_NAMES), *[HEAD] * 3, *[OFFSET] * 3]).T


class Smoother:
    """The filter's state, for the 52 shapes and the head's rotation vector and offset."""

    def __init__(self) -> None:
        self._value: Float64Array | None = None
        self._speed = np.zeros(len(_CUTOFF_HZ))
        self._gaze = np.zeros(int(GAZE.sum()))

    def reset(self) -> None:
        """Forget the past: the next sample comes through as it is."""
        self._value = None

    def smooth(
        self, arkit: FloatArray, rotation: FloatArray, offset_m: FloatArray, step_s: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Filter the next sample, `step_s` > 0 after the one before; the gaze rests while both eyes
        are closed. Finite, float32 ``[52]``, ``[3]`` and ``[3]``."""
        raw = np.concatenate((arkit, rotation, offset_m)).astype(np.float64)
        count = len(arkit)
        if self._value is None:
            self._value, self._speed = raw, np.zeros_like(raw)
            self._gaze = raw[:count][GAZE]
        else:
            speed = (raw - self._value) / step_s
            self._speed += _share(DERIVATIVE_CUTOFF_HZ, step_s) * (speed - self._speed)
            cutoff_hz = _CUTOFF_HZ + _SPEED_FACTOR * np.abs(self._speed)
            self._value = self._value + _share(cutoff_hz, step_s) * (raw - self._value)
        smoothed = self._value.astype(np.float32)
        if min(smoothed[BLINKS[0]], smoothed[BLINKS[1]]) > CLOSED:
            smoothed[:count][GAZE] = self._gaze
        else:
            self._gaze = self._value[:count][GAZE]
        return smoothed[:count], smoothed[count : count + 3], smoothed[count + 3 :]


def _share(cutoff_hz: Float64Array | float, step_s: float) -> Float64Array | float:
    """How much of a new sample a low-pass takes."""
    turn = 2 * np.pi * cutoff_hz * step_s
    share: Float64Array | float = turn / (1 + turn)
    return share
