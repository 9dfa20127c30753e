"""From samples that arrive when they arrive to a face at any moment. Pure: `now` is an argument.

A sample is placed on our clock by the tracker's own time, plus the least way it has taken of late;
what the network adds to that is jitter. The face is shown so much later than it was seen that the
next sample is usually there, and interpolated between two. When the samples end, or the tracker
sees no face, it holds, eases to rest, and then there is none; it comes back without a snap.
"""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from pica_client.sources.calibration import BLINKS, GAZE, Calibration
from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES, NUM_ARKIT, ExpressionFrame
from pica_core.types import Float64Array, FloatArray


def rotation_vector_from_yaw_pitch_roll(yaw_pitch_roll: Float64Array) -> FloatArray:
    """Compose yaw about +y, then pitch about +x, then roll about +z, each in the turned frame.

    Args:
        yaw_pitch_roll: Radians. float64 ``[T, 3]``.

    Returns:
        Rotation vectors (axis times angle, angle at most π). float32 ``[T, 3]``.
    """
    turns = []
    for yaw, pitch, roll in (yaw_pitch_roll / 2).tolist():
        tilted = _product(
            (math.cos(yaw), 0.0, math.sin(yaw), 0.0), (math.cos(pitch), math.sin(pitch), 0.0, 0.0)
        )
        rolled = _product(tilted, (math.cos(roll), 0.0, 0.0, math.sin(roll)))
        turns.append(rotation_vector_from_quaternion(rolled))
    return np.array(turns, np.float32).reshape(-1, 3)


def yaw_pitch_roll_from_rotation_vector(rotation: FloatArray) -> tuple[float, float, float]:
    """The angles, radians, that `rotation_vector_from_yaw_pitch_roll` composes to a rotation."""
    w, x, y, z = _quaternion(rotation)
    yaw = math.atan2(2 * (x * z + w * y), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(max(2 * (w * x - y * z), -1.0), 1.0))
    return yaw, pitch, math.atan2(2 * (x * y + w * z), 1 - 2 * (x * x + z * z))


def turned(rotation: FloatArray, turn: FloatArray) -> FloatArray:
    """A rotation, and after it another turn; all are rotation vectors, float32 ``[3]``."""
    return rotation_vector_from_quaternion(_product(_quaternion(turn), _quaternion(rotation)))


def _quaternion(vector: FloatArray) -> tuple[float, float, float, float]:
    """The unit quaternion (real part first) of a rotation vector."""
    x, y, z = vector.tolist()
    angle = math.hypot(x, y, z)
    scale = math.sin(angle / 2) / angle if angle > 1e-12 else 0.5
    return math.cos(angle / 2), scale * x, scale * y, scale * z


def rotation_vector_from_quaternion(quaternion: Sequence[float]) -> FloatArray:
    """The rotation vector of a quaternion, with an angle of at most π."""
    real, *imaginary = quaternion
    if real < 0:  # an angle above π is the rest of the turn, the other way round
        real, imaginary = -real, [-part for part in imaginary]
    sine = math.hypot(*imaginary)
    scale = 2 * math.atan2(sine, real) / sine if sine > 1e-12 else 2.0
    return np.array([scale * part for part in imaginary], np.float32)


def _product(left: Sequence[float], right: Sequence[float]) -> tuple[float, float, float, float]:
    """The turn `right`, and after it `left`."""
    a, b, c, d = left
    e, f, g, h = right
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


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
CLOSED: Final = 0.5
"""Lids that are both this far down hide where the eyes look, and trackers guess it."""


def _of_shape(name: str) -> tuple[float, float]:
    return next(each for starts, each in REGIONS.items() if name.startswith(starts))


_CUTOFF_HZ, _SPEED_FACTOR = np.array([*map(_of_shape, ARKIT_NAMES), *[HEAD] * 3, *[OFFSET] * 3]).T


class Smoother:
    """The filter's state for poses: 52 shapes, the head's rotation vector and offset. ``[58]``."""

    def __init__(self) -> None:
        self._value: Float64Array | None = None
        self._speed = np.zeros(len(_CUTOFF_HZ))
        self._gaze = np.zeros(int(GAZE.sum()))

    def reset(self) -> None:
        """Forget the past: the next sample comes through as it is."""
        self._value = None

    def smooth(self, pose: FloatArray, step_s: float) -> FloatArray:
        """Filter the next pose, `step_s` > 0 after the one before; the gaze rests while both eyes
        are closed."""
        raw = pose.astype(np.float64)
        if self._value is None:
            self._value, self._speed = raw, np.zeros_like(raw)
            self._gaze = raw[:NUM_ARKIT][GAZE]
        else:
            speed = (raw - self._value) / step_s
            self._speed += _share(DERIVATIVE_CUTOFF_HZ, step_s) * (speed - self._speed)
            cutoff_hz = _CUTOFF_HZ + _SPEED_FACTOR * np.abs(self._speed)
            self._value = self._value + _share(cutoff_hz, step_s) * (raw - self._value)
        smoothed = self._value.astype(np.float32)
        if min(smoothed[BLINKS[0]], smoothed[BLINKS[1]]) > CLOSED:
            smoothed[:NUM_ARKIT][GAZE] = self._gaze
        else:
            self._gaze = self._value[:NUM_ARKIT][GAZE]
        return smoothed


def _share(cutoff_hz: Float64Array | float, step_s: float) -> Float64Array | float:
    """How much of a new sample a low-pass takes."""
    turn = 2 * np.pi * cutoff_hz * step_s
    share: Float64Array | float = turn / (1 + turn)
    return share


VALUE_LIMIT = 4.0
"""Blendshape values beyond this are no face (chosen: real recordings reach 1.05)."""


class PacketError(Exception):
    """A datagram that is not what the tracker should send; says how to mend it, if that is
    known."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackerSample:
    """One sample of a live tracker.

    Attributes:
        tracker_s: When the face looked like this on the tracker's clock, seconds; None if the
            tracker does not say.
        arkit: Blendshape values in `ARKIT_NAMES` order; NaN where the tracker sends none. float32
            ``[52]``.
        rotation: Head rotation vector, radians, head frame. float32 ``[3]``.
        place_m: Where the head is before the tracker, metres, axes of a head that looks at it (+x
            the subject's left, +y up, +z towards the tracker); None if the tracker does not say.
            float32 ``[3]``.
        has_face: False while the tracker sees no face.
    """

    tracker_s: float | None = None
    arkit: FloatArray = field(default_factory=lambda: np.full(NUM_ARKIT, np.nan, np.float32))
    rotation: FloatArray = field(default_factory=lambda: np.zeros(3, np.float32))
    place_m: FloatArray | None = None
    has_face: bool = True


def arkit_from_names(values: dict[str, float]) -> FloatArray:
    """Put values by ARKit name, in any case, into their order: float32 ``[52]``, NaN where no value
    was given. Names that ARKit does not have are left out."""
    arkit = np.full(NUM_ARKIT, np.nan, np.float32)
    for name, value in values.items():
        index = INDEX_BY_FOLDED_NAME.get(name.lower())
        if index is not None:
            arkit[index] = value
    return arkit


INDEX_BY_FOLDED_NAME = {name.lower(): index for name, index in ARKIT_INDEX.items()}
"""Place of each shape by its name in lower case."""


FOLLOWS_S: Final = 8.0
"""How long the seat takes to come two thirds of the way."""
REACH_M: Final = np.array([0.15, 0.10, 0.15])
"""How far a head goes from its seat: sideways, up and down, to and fro."""


class Seat:
    """Where one person sits before one tracker, which says where a head is before its camera.

    The seat is where the head is when it is first seen, and it follows slowly: a person who moves
    the chair is in the middle again a little later. What is left is limited to what a seat allows.
    """

    def __init__(self) -> None:
        self._place_m: Float64Array | None = None

    def reset(self) -> None:
        """After an absence the next place is the seat."""
        self._place_m = None

    def offset_m(self, place_m: FloatArray | None, step_s: float) -> FloatArray:
        """How far the head is from its seat: metres, seat axes, within `REACH_M`. float32 ``[3]``.

        Args:
            place_m: As `TrackerSample.place_m`; None is the seat itself.
            step_s: Time since the sample before.
        """
        if place_m is None:
            return np.zeros(3, np.float32)
        place = place_m.astype(np.float64)
        if self._place_m is None:
            self._place_m = place
        self._place_m += min(step_s / FOLLOWS_S, 1.0) * (place - self._place_m)
        offset: FloatArray = np.clip(place - self._place_m, -REACH_M, REACH_M).astype(np.float32)
        return offset


HOLD_S: Final = 0.2
"""How long a face that is lost stands still: most losses are shorter."""
EASE_S: Final = 0.4
"""How long it then takes to come to rest, and later to come back."""
MAX_DELAY_S: Final = 0.08
"""Longest wait for a sample that is late; beyond it the face stands still for a moment."""
MAX_WAY_S: Final = 0.15
"""A sample is not taken for older than this when it arrives: clocks that count frames fall behind,
if fewer frames are made than the tracker says, and a face that comes is not lost."""
CLOCK_JUMP_S: Final = 1.0
"""A tracker's clock that is this far off has been reset."""
KEPT_SAMPLES: Final = 64
USUAL_SHARE: Final = 0.9
"""Share of the samples that is waited for."""


_REST: Final[FloatArray] = np.zeros(NUM_ARKIT + 6, np.float32)


def _towards(pose: FloatArray, other: FloatArray, weight: float) -> FloatArray:
    """A pose on the way to another. Rotation vectors go straight, too: exactly so to rest, and
    between samples that are near each other with an error below the trackers' noise."""
    mixed: FloatArray = pose + np.float32(weight) * (other - pose)
    return mixed


class LiveFace:
    """One person's face, fed by a tracker.

    Attributes:
        calibration: What is done to each sample.
    """

    def __init__(self, calibration: Calibration | None = None) -> None:
        self.calibration = calibration or Calibration()
        self._smoother, self._seat = Smoother(), Seat()
        self._times_s: deque[float] = deque(maxlen=KEPT_SAMPLES)
        self._poses: deque[FloatArray] = deque(maxlen=KEPT_SAMPLES)
        self._ways_s: deque[float] = deque(maxlen=4 * KEPT_SAMPLES)
        self._waits_s: deque[float] = deque(maxlen=KEPT_SAMPLES)
        self._lost_s: float | None = None
        self._returned_s: float | None = None
        self._shown = _REST
        self._left = _REST
        self._shown_s = -np.inf

    def push(self, sample: TrackerSample, arrived_s: float) -> None:
        """Take a sample.

        Args:
            arrived_s: When, on our clock.
        """
        seen_s = self._on_our_clock(sample.tracker_s, arrived_s)
        if self._times_s and seen_s <= self._times_s[-1]:
            return
        if not sample.has_face:
            self._lost_s = seen_s if self._lost_s is None else self._lost_s
            return
        gap_s = seen_s - self._times_s[-1] if self._times_s else np.inf
        if gap_s > HOLD_S or self._lost_s is not None:
            self._smoother.reset()
            self._seat.reset()
            self._returned_s = seen_s
        self._lost_s = None
        raw = np.nan_to_num(sample.arkit, nan=0.0)
        arkit = self.calibration.apply(raw)
        step_s = min(gap_s, HOLD_S)
        offset_m = self._seat.offset_m(sample.place_m, step_s)
        pose = np.concatenate((arkit, sample.rotation, offset_m))
        self._poses.append(self._smoother.smooth(pose, step_s))
        self._times_s.append(seen_s)
        # Shown by the time that the next one is there, a moment has waited for so long.
        self._waits_s.append(min(arrived_s - seen_s + gap_s, MAX_DELAY_S))

    @property
    def delay_s(self) -> float:
        """How much later than it was seen a face is shown, smoothing apart."""
        return float(np.quantile(self._waits_s, USUAL_SHARE)) if self._waits_s else 0.0

    def face_at(self, now: float) -> ExpressionFrame:
        """The face to show.

        Args:
            now: On our clock, seconds; rising from call to call.

        Returns:
            The face; `captured_us` is when a microphone heard what was seen, on our clock.
        """
        shown_s = max(now - self.delay_s, self._shown_s)
        self._shown_s = shown_s
        pose = self._pose_at(shown_s)
        if pose is not None:
            self._shown = pose
        return ExpressionFrame(
            captured_us=round((shown_s - self.calibration.sound_offset_s) * 1e6),
            arkit=self._shown[:NUM_ARKIT],
            rotation=self._shown[NUM_ARKIT : NUM_ARKIT + 3],
            translation_m=self._shown[NUM_ARKIT + 3 :],
            has_face=pose is not None,
        )

    def _pose_at(self, time_s: float) -> FloatArray | None:
        after = bisect_right(self._times_s, time_s)
        if not self._times_s or after == 0:
            return self._shown if self._times_s else None
        if after < len(self._times_s):
            begin_s, end_s = self._times_s[after - 1], self._times_s[after]
            weight = (time_s - begin_s) / (end_s - begin_s)
            pose = _towards(self._poses[after - 1], self._poses[after], weight)
        else:
            pose = self._poses[-1]
        last_s = self._times_s[-1] if self._lost_s is None else min(self._lost_s, time_s)
        lost_for_s = time_s - last_s - HOLD_S
        if lost_for_s > EASE_S:
            self._left = _REST
            return None
        if lost_for_s > 0:
            pose = _towards(pose, _REST, _eased(lost_for_s / EASE_S))
            self._left = pose
            return pose
        if self._returned_s is not None:
            since_s = time_s - self._returned_s
            if since_s < EASE_S:
                return _towards(self._left, pose, _eased(max(since_s, 0.0) / EASE_S))
            self._returned_s = None
        self._left = pose
        return pose

    def _on_our_clock(self, tracker_s: float | None, arrived_s: float) -> float:
        if tracker_s is None:
            return arrived_s
        way_s = arrived_s - tracker_s
        if self._ways_s and abs(way_s - min(self._ways_s)) > CLOCK_JUMP_S:
            self._ways_s.clear()
        self._ways_s.append(way_s)
        return max(tracker_s + min(self._ways_s), arrived_s - MAX_WAY_S)


def _eased(share: float) -> float:
    """A smooth way from 0 to 1."""
    return share * share * (3 - 2 * share)
