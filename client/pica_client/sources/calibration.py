"""Whose face it is: what one person's tracker says at rest, and with closed eyes.

A tracker gives most people a little smile or squint at rest. What it says then is taken as zero,
and the rest of the range is stretched so that the end stays at 1. Lids have two levels of their
own, open and closed: a neutral that is taken away would keep them from closing. Gaze stays as it
is.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from pica_client.errors import SourceError
from pica_client.system import make_private
from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES, NUM_ARKIT
from pica_core.files import FOLDERS, replacing
from pica_core.types import BoolArray, FloatArray

MAX_NEUTRAL: Final = 0.6
"""Highest neutral taken away (chosen): beyond it the rest of the range would be noise."""
MIN_LID_RANGE: Final = 0.2
"""Least difference between open and closed lids; less is no closed eye."""
MAX_VALUE: Final = 2.0
"""Beyond it no tracker's value lies."""
MAX_SOUND_OFFSET_S: Final = 0.5
BLINKS: Final = (ARKIT_INDEX["eyeBlinkLeft"], ARKIT_INDEX["eyeBlinkRight"])
GAZE: Final[BoolArray] = np.array([name.startswith("eyeLook") for name in ARKIT_NAMES])
_LIDS = list(BLINKS)
_KEPT = GAZE.copy()
_KEPT[_LIDS] = True


@dataclass(frozen=True, kw_only=True, slots=True)
class Calibration:
    """One person's face before one tracker.

    Raises:
        SourceError: A value that cannot be; names it.
    """

    neutral: tuple[float, ...] = (0.0,) * NUM_ARKIT
    """What the tracker says at rest, in `ARKIT_NAMES` order."""
    lid_open: tuple[float, float] = (0.0, 0.0)
    """eyeBlinkLeft and eyeBlinkRight with open eyes."""
    lid_closed: tuple[float, float] = (1.0, 1.0)
    """The same with closed eyes."""
    sound_offset_s: float = 0.0
    """How much later the tracker sees a mouth than the microphone hears it."""

    def __post_init__(self) -> None:
        numbers = np.array([*self.neutral, *self.lid_open, *self.lid_closed])
        if len(self.neutral) != NUM_ARKIT or len(numbers) != NUM_ARKIT + 4:
            raise SourceError(f"a calibration has {NUM_ARKIT} neutral values and two of each lid")
        if not (np.abs(numbers) <= MAX_VALUE).all():
            raise SourceError(f"a calibration holds a value beyond ±{MAX_VALUE:g}")
        if not abs(self.sound_offset_s) <= MAX_SOUND_OFFSET_S:
            raise SourceError(f"a sound offset of {self.sound_offset_s:g} s is no tracker's")
        if np.min(np.subtract(self.lid_closed, self.lid_open)) < MIN_LID_RANGE:
            raise SourceError("closed and open lids of a calibration are too near to each other")

    def apply(self, arkit: FloatArray) -> FloatArray:
        """Give the face as the same person before a perfect tracker would.

        Args:
            arkit: Values of the tracker, finite. float32 ``[52]``.
        """
        neutral = np.clip(np.array(self.neutral, np.float32), 0, MAX_NEUTRAL)
        neutral[_KEPT] = 0
        moved = (arkit - neutral) / (1 - neutral)
        calibrated = np.where(neutral > 0, np.maximum(moved, 0), moved).astype(np.float32)
        opened, closed = np.array(self.lid_open), np.array(self.lid_closed)
        calibrated[_LIDS] = np.clip((arkit[_LIDS] - opened) / (closed - opened), 0, 1)
        return calibrated


def calibrate(at_rest: Sequence[FloatArray], eyes_closed: Sequence[FloatArray]) -> Calibration:
    """Make a calibration of what was seen.

    Args:
        at_rest: Samples of a relaxed face that looks ahead, NaN where the tracker sends none. Each
            float32 ``[52]``.
        eyes_closed: Samples with closed eyes; none keeps the usual level.

    Raises:
        SourceError: No sample, or the eyes were not closed.
    """
    if not at_rest:
        raise SourceError("no face was seen; let the tracker see you and try again")
    neutral = np.nan_to_num(np.median(at_rest, axis=0))
    lid_closed = (1.0, 1.0)
    if eyes_closed:
        seen = np.nan_to_num(np.median([sample[_LIDS] for sample in eyes_closed], axis=0))
        if np.min(seen - neutral[_LIDS]) < MIN_LID_RANGE:
            raise SourceError("the eyes did not close; try again, or leave --eyes-closed out")
        lid_closed = (float(seen[0]), float(seen[1]))
    lid_open = neutral[_LIDS]
    return Calibration(
        neutral=tuple(float(value) for value in neutral),
        lid_open=(float(lid_open[0]), float(lid_open[1])),
        lid_closed=lid_closed,
    )


def load_calibration(person: str, kind: str) -> Calibration | None:
    """What was stored on this machine for a person and a kind of source, or None.

    Raises:
        SourceError: The file is no calibration; says how to make another.
    """
    path = _path(person, kind)
    try:
        values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        for name in values.keys() - {"sound_offset_s"}:
            values[name] = tuple(values[name])
        return Calibration(**values)
    except FileNotFoundError:
        return None
    except (OSError, LookupError, ValueError, TypeError, AttributeError, SourceError) as error:
        raise SourceError(
            f"{path}: is no calibration ({error}); `pica calibrate {kind}` makes another"
        ) from error


def save_calibration(person: str, kind: str, calibration: Calibration) -> Path:
    """Store it, readable for its owner alone, and return where.

    Raises:
        SourceError: The system says no.
    """
    path = _path(person, kind)
    try:
        make_private(path.parent)
        with replacing(path) as unfinished:
            unfinished.touch(mode=0o600)
            unfinished.write_text(json.dumps(asdict(calibration)), encoding="utf-8")
    except OSError as error:
        raise SourceError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def _path(person: str, kind: str) -> Path:
    name = "".join(each if each.isalnum() else "_" for each in person) or "_"
    return FOLDERS.user_config_path / "calibrations" / f"{name}.{kind}.json"
