"""Whose face it is: what one person's tracker says at rest, and with closed eyes.

A tracker gives most people a little smile or squint at rest. What it says then is taken as zero,
and the rest of the range is stretched so that the end stays at 1. Lids have two levels of their
own, open and closed: a neutral that is taken away would keep them from closing. Gaze stays as it
is.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from pica_client.errors import SourceError
from pica_client.user_folders import make_private
from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES, NUM_ARKIT
from pica_core.files import replacing
from pica_core.types import BoolArray, Float64Array, FloatArray

MAX_NEUTRAL: Final = 0.6
"""Highest neutral taken away (chosen): beyond it the rest of the range would be noise."""
MIN_LID_RANGE: Final = 0.2
"""Least difference between open and closed lids; less is no closed eye."""
MAX_GAIN: Final = 2.0
"""More would make cross-talk of the tracker into a movement."""
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
    gain: float = 1.0
    """What all shapes but lids and gaze are multiplied by, 1 to 2."""
    sound_offset_s: float = 0.0
    """How much later the tracker sees a mouth than the microphone hears it (`sound_offset`)."""

    def __post_init__(self) -> None:
        numbers = np.array([*self.neutral, *self.lid_open, *self.lid_closed, self.gain])
        if len(self.neutral) != NUM_ARKIT or len(numbers) != NUM_ARKIT + 5:
            raise SourceError(f"a calibration has {NUM_ARKIT} neutral values and two of each lid")
        if not (np.abs(numbers) <= MAX_GAIN).all() or self.gain < 1:
            raise SourceError(
                f"a calibration holds a value beyond ±{MAX_GAIN:g}, or a gain below 1"
            )
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
        moved = (arkit - neutral) / (1 - neutral) * np.where(_KEPT, 1, self.gain)
        calibrated = np.where(neutral > 0, np.maximum(moved, 0), moved).astype(np.float32)
        opened, closed = np.array(self.lid_open), np.array(self.lid_closed)
        calibrated[_LIDS] = np.clip((arkit[_LIDS] - opened) / (closed - opened), 0, 1)
        return np.minimum(calibrated, np.maximum(arkit, 1)) if self.gain > 1 else calibrated


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


@dataclass(frozen=True, slots=True)
class CalibrationStore:
    """The calibrations of this machine's people, one file for a person and a kind of source.

    Attributes:
        folder: Where they are; it need not be there yet.
    """

    folder: Path = field()

    def load(self, person: str, kind: str) -> Calibration | None:
        """What was stored, or None.

        Raises:
            SourceError: The file is no calibration; says how to make another.
        """
        path = self._path(person, kind)
        try:
            values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            for name in values.keys() - {"gain", "sound_offset_s"}:
                values[name] = tuple(values[name])
            return Calibration(**values)
        except FileNotFoundError:
            return None
        except (OSError, LookupError, ValueError, TypeError, AttributeError, SourceError) as error:
            raise SourceError(
                f"{path}: is no calibration ({error}); `pica calibrate {kind}` makes another"
            ) from error

    def save(self, person: str, kind: str, calibration: Calibration) -> Path:
        """Store it, readable for its owner alone, and return where.

        Raises:
            SourceError: The system says no.
        """
        path = self._path(person, kind)
        try:
            make_private(path.parent)
            with replacing(path) as unfinished:
                unfinished.touch(mode=0o600)
                unfinished.write_text(json.dumps(asdict(calibration)), encoding="utf-8")
        except OSError as error:
            raise SourceError(f"{path}: cannot be written: {error.strerror}") from error
        return path

    def _path(self, person: str, kind: str) -> Path:
        name = "".join(each if each.isalnum() else "_" for each in person) or "_"
        return self.folder / f"{name}.{kind}.json"


STEP_S: Final = 0.002
"""Sound is looked at in pieces of this length."""
QUIET_S: Final = 0.25
"""How long it must have been quiet before a plosive."""
BURST_RATIO: Final = 10.0
"""Root mean square of a burst, over that of the quiet before it (chosen: 20 dB)."""
BURST_RMS: Final = 0.003
"""Least root mean square of a burst: -50 dB of full scale."""
EARLY_S, LATE_S = 0.15, 0.5
"""How long before and after its burst a mouth may be seen to open."""
LEAST_RISE: Final = 0.1
"""Least opening of a mouth that is one."""
NUM_AGREEING: Final = 3
"""Plosives that must be clear."""
AGREEING_S: Final = 0.03
"""How near to their median."""


def sound_offset(
    opening: Sequence[tuple[float, float]], sound: FloatArray, sound_begin_s: float, rate_hz: float
) -> tuple[float, int]:
    """Measure how much later mouths are seen than heard.

    Args:
        opening: When a face was seen on our clock, seconds, rising, and how far its mouth is open,
            0 to 1.
        sound: What the microphone heard. float32 ``[N]``.
        sound_begin_s: When its first sample was captured, on the same clock.
        rate_hz: Samples of it a second.

    Returns:
        The offset in seconds, the median of those that agree, and how many these are.

    Raises:
        SourceError: Too few plosives were heard and seen; says how to do better.
    """
    times_s, openings = np.array(opening, np.float64).reshape(-1, 2).T
    found = [
        seen_s - heard_s
        for heard_s in _bursts(sound, rate_hz) + sound_begin_s
        if (seen_s := _opens(times_s, openings, heard_s)) is not None
    ]
    middle_s = float(np.median(found)) if found else 0.0
    agreeing = [each for each in found if abs(each - middle_s) <= AGREEING_S]
    if len(agreeing) < NUM_AGREEING:
        raise SourceError(
            f"{len(agreeing)} of {len(found)} openings of the mouth fit to a sound, "
            f'{NUM_AGREEING} are needed; say "pa", close your lips, wait a second, and again'
        )
    return float(np.median(agreeing)), len(agreeing)


def _bursts(sound: FloatArray, rate_hz: float) -> Float64Array:
    """When it becomes loud after a silence, seconds from the sound's beginning."""
    size, quiet = round(STEP_S * rate_hz), round(QUIET_S / STEP_S)
    steps = sound[: len(sound) // size * size].reshape(-1, size)
    rms = np.sqrt(np.mean(np.square(steps, dtype=np.float64), axis=1))
    begins, at = [], quiet
    while at < len(rms):
        # Clicks of one piece are no room noise.
        floor = float(np.quantile(rms[at - quiet : at], 0.9))
        if rms[at] > max(BURST_RATIO * floor, BURST_RMS):
            begins.append(at * STEP_S)
            at += quiet
        at += 1
    return np.array(begins, np.float64)


def _opens(times_s: Float64Array, openings: Float64Array, heard_s: float) -> float | None:
    """When the mouth that was heard then is seen to begin to open; None where it does not."""
    near = (times_s >= heard_s - EARLY_S) & (times_s <= heard_s + LATE_S)
    times, values = times_s[near], openings[near]
    if len(times) < 4:
        return None
    top = int(np.argmax(values))
    shut = top - int(np.argmin(values[top::-1]))
    rise = values[top] - values[shut]
    if rise < LEAST_RISE:
        return None
    # Where the line through a fifth and a half of the rise meets the closed mouth.
    fifth_s, half_s = (
        float(np.interp(values[shut] + share * rise, values[shut : top + 1], times[shut : top + 1]))
        for share in (0.2, 0.5)
    )
    return fifth_s - (half_s - fifth_s) * 0.2 / 0.3
