"""A take: what a tracker sent, as it arrived, in a file; and its playing, trouble included.

The file is a numpy archive of arrays, without pickles. Playing it gives the samples to a `LiveFace`
at the times at which they came, so a stutter, a loss or a jump of the clock happens again, on any
clock.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from pica_client.errors import SourceError
from pica_client.sources.live.live_face import LiveFace
from pica_client.sources.live.sample import VALUE_LIMIT, TrackerSample
from pica_core.avatar.arkit import NUM_ARKIT, ExpressionFrame
from pica_core.files import replacing
from pica_core.types import BoolArray, Float64Array, FloatArray

FORMAT: Final = "pica take 1"
MAX_SAMPLES: Final = 1_000_000
"""Longest take (chosen: 4.6 hours at 60 a second)."""
MIN_LOOP_GAP_S: Final = 0.02
_SHAPES: Final[dict[str, tuple[tuple[int, ...], type]]] = {
    "arrived_s": ((), np.float64),
    "tracker_s": ((), np.float64),
    "arkit": ((NUM_ARKIT,), np.float32),
    "rotation": ((3,), np.float32),
    "has_face": ((), np.bool_),
    "place_m": ((3,), np.float32),
}
"""What each array of a take has: the shape of a row, and its elements."""
_NOWHERE: Final[FloatArray] = np.full(3, np.nan, np.float32)


@dataclass
class Take:
    """Samples of a tracker in the order in which they arrived, and a source that plays them: the
    same face at the same time, whatever the clock; it loops.

    Attributes:
        arrived_s: Seconds since the first one, not falling. float64 ``[T]``.
        tracker_s: Times of the tracker, NaN where it gave none. float64 ``[T]``.
        arkit: Values, NaN where the tracker sent none. float32 ``[T, 52]``.
        rotation: Head rotation vectors, radians. float32 ``[T, 3]``.
        has_face: Whether the tracker saw somebody. bool ``[T]``.
        place_m: Where the head was, NaN where the tracker did not say, as in takes that were made
            before it was kept. float32 ``[T, 3]``.
        start_s: Where in the take the source begins, seconds.
    """

    arrived_s: Float64Array
    tracker_s: Float64Array
    arkit: FloatArray
    rotation: FloatArray
    has_face: BoolArray
    place_m: FloatArray
    start_s: float = 0.0

    def __post_init__(self) -> None:
        self._turn, self._next, self._asked_s = 0, 0, 0.0
        self._face = LiveFace()

    def sample(self, index: int) -> TrackerSample:
        """One of the samples."""
        tracker_s, place_m = float(self.tracker_s[index]), self.place_m[index]
        return TrackerSample(
            tracker_s=None if np.isnan(tracker_s) else tracker_s,
            arkit=self.arkit[index],
            rotation=self.rotation[index],
            place_m=None if np.isnan(place_m).any() else place_m,
            has_face=bool(self.has_face[index]),
        )

    @property
    def duration_s(self) -> float:
        """Length of one turn of the loop."""
        count = len(self.arrived_s)
        gap_s = self.arrived_s[-1] / max(count - 1, 1)
        return float(self.arrived_s[-1] + max(gap_s, MIN_LOOP_GAP_S))

    def frame_at(self, time_s: float) -> ExpressionFrame:
        """The face at a time; see `Source.frame_at`. A step back begins the take anew."""
        turn, looped_s = divmod(time_s + self.start_s, self.duration_s)
        if turn != self._turn or looped_s < self._asked_s:
            self._turn, self._next = int(turn), 0
            self._face = LiveFace()
        arrived_s = self.arrived_s
        while self._next < len(arrived_s) and arrived_s[self._next] <= looped_s:
            self._face.push(self.sample(self._next), float(arrived_s[self._next]))
            self._next += 1
        self._asked_s = looped_s
        frame = self._face.face_at(looped_s)
        return replace(frame, captured_us=frame.captured_us + round((time_s - looped_s) * 1e6))


@dataclass(slots=True)
class TakeRecorder:
    """Gathers a take; a `SampleTap`."""

    samples: list[tuple[float, TrackerSample]] = field(default_factory=list)

    def __call__(self, sample: TrackerSample, arrived_s: float, process_s: float) -> None:
        """Keep a sample."""
        if len(self.samples) < MAX_SAMPLES:
            self.samples.append((arrived_s, sample))

    def save(self, path: Path) -> None:
        """Write the take.

        Raises:
            SourceError: Nothing was recorded, or the file cannot be written.
        """
        if not self.samples:
            raise SourceError(f"{path}: not written, because nothing was recorded")
        arrived_s = np.array([arrived for arrived, _ in self.samples])
        samples = [sample for _, sample in self.samples]
        times_s = [np.nan if each.tracker_s is None else each.tracker_s for each in samples]
        try:
            with replacing(path) as unfinished, unfinished.open("wb") as file:
                np.savez_compressed(
                    file,
                    format=np.array(FORMAT),
                    arrived_s=arrived_s - arrived_s[0],
                    tracker_s=np.array(times_s),
                    arkit=np.stack([each.arkit for each in samples]),
                    rotation=np.stack([each.rotation for each in samples]),
                    has_face=np.array([each.has_face for each in samples]),
                    place_m=np.stack(
                        [_NOWHERE if each.place_m is None else each.place_m for each in samples]
                    ),
                )
        except OSError as error:
            raise SourceError(f"{path}: cannot be written: {error.strerror}") from error


def load_take(path: Path, start_s: float = 0.0) -> Take:
    """Read a take, to be played from some time on.

    Raises:
        SourceError: No such file, or it is no take.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            if str(archive["format"]) != FORMAT:
                raise SourceError(f"{path}: is a take of another version")
            arrays: dict[str, Any] = dict(archive)
            arrays.setdefault("place_m", np.tile(_NOWHERE, (len(arrays["rotation"]), 1)))
            take = Take(**{name: arrays[name] for name in _SHAPES}, start_s=start_s)
    except OSError as error:
        raise SourceError(f"{path}: cannot be read ({error.strerror or error})") from error
    except SourceError:
        raise
    except Exception as error:  # numpy and zipfile raise what the bytes lead them to
        raise SourceError(f"{path}: is no take; `pica track SOURCE --record` makes one") from error
    count = len(take.arrived_s) if take.arrived_s.ndim == 1 else 0
    for name, (row, kind) in _SHAPES.items():
        array = getattr(take, name)
        if array.shape != (count, *row) or array.dtype != kind or not 0 < count <= MAX_SAMPLES:
            raise SourceError(f"{path}: {name} is {array.dtype} {array.shape}; the file is no take")
    if not (np.diff(take.arrived_s) >= 0).all() or take.arrived_s[0] != 0:
        raise SourceError(f"{path}: arrived_s must begin at 0 and not fall")
    numbers = (take.arkit, take.rotation, take.tracker_s, take.place_m)
    if np.isnan(take.rotation).any() or any(np.isinf(each).any() for each in numbers):
        raise SourceError(f"{path}: a value is infinite, or no number")
    if np.abs(np.nan_to_num(take.arkit)).max() > VALUE_LIMIT:
        raise SourceError(f"{path}: a value lies outside ±{VALUE_LIMIT:g}")
    return take
