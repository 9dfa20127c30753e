"""A take: what a tracker sent, as it arrived, in a file; and its playing, trouble included.

The file is a numpy archive of arrays, without pickles. Playing it gives the samples to a `LiveFace`
at the times at which they came, so a stutter, a loss or a jump of the clock happens again, on any
clock.
"""

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from pica_client.errors import SourceError
from pica_client.sources.live.live_face import VALUE_LIMIT, LiveFace, TrackerSample
from pica_core.avatar.arkit import ARKIT_NAMES, NUM_ARKIT, ExpressionFrame
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
        has_face: True where the tracker saw a face. bool ``[T]``.
        place_m: Where the head was, NaN where the tracker did not say. float32 ``[T, 3]``.
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
        """The face at a time; see `Source.frame_at`. A step back begins the take again."""
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


LOW_FPS: Final = 20.0
LONG_GAP_MS: Final = 150.0
CONSTANT: Final = 1e-4
"""A shape that moves by less than this in all the time never moves."""
SHIFTED_AT_REST: Final = 0.15
"""Fifth percentile of a shape above this: the face at rest is not at rest."""
MANY_CONSTANT: Final = 5
NAMED_SHAPES: Final = 6
"""Names in a hint before it says how many more."""


@dataclass(slots=True)
class Recorder:
    """Gathers what a tracker sends, to keep it as a take and to report on it; a `SampleTap`."""

    samples: list[tuple[float, TrackerSample]] = field(default_factory=list)
    """When each arrived, and what it was."""

    def __call__(self, sample: TrackerSample, arrived_s: float) -> None:
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
        arrived_s, samples = self._columns()
        times_s = [np.nan if each.tracker_s is None else each.tracker_s for each in samples]
        places_m = [_NOWHERE if each.place_m is None else each.place_m for each in samples]
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
                    place_m=np.stack(places_m),
                )
        except OSError as error:
            raise SourceError(f"{path}: cannot be written: {error.strerror}") from error

    def report(self, trouble: str, refused: Counter[str], subjects: Counter[str]) -> dict[str, Any]:
        """What came, and what would mend it; times in milliseconds, angles in degrees.

        Args:
            trouble: Why there is no face, as the source says.
            refused: Datagrams that were not the tracker's, by reason.
            subjects: Samples by subject.
        """
        arrived_s, samples = self._columns()
        seen = [sample for sample in samples if sample.has_face]
        arkit = np.array([sample.arkit for sample in seen]).reshape(-1, NUM_ARKIT)
        turns = np.degrees([sample.rotation for sample in seen]).reshape(-1, 3)
        count = len(samples)
        span_s = float(arrived_s[-1] - arrived_s[0]) if count > 1 else 0.0
        # How much longer than the shortest way each sample took, by the tracker's clock.
        ways_s = np.array(
            [at_s - each.tracker_s for at_s, each in self.samples if each.tracker_s is not None]
        )
        report = {
            "frames": count,
            "fps": round((count - 1) / span_s, 2) if span_s else None,
            "gap_ms": _percentiles(np.diff(arrived_s)),
            "jitter_ms": _percentiles(ways_s - ways_s.min() if len(ways_s) else ways_s),
            "no_face_ratio": round(1 - len(seen) / count, 4) if count else None,
            "shapes": {
                name: _range(arkit[:, index])
                for index, name in enumerate(ARKIT_NAMES)
                if len(arkit) and not np.isnan(arkit[:, index]).all()
            },
            "head": {
                name: _range(turns[:, axis])
                for name, axis in (("yaw", 1), ("pitch", 0), ("roll", 2))
                if len(turns)
            },
            "refused": dict(refused),
            "subjects": dict(subjects),
        }
        return report | {"hints": _hints(report, trouble, subjects)}

    def _columns(self) -> tuple[Float64Array, list[TrackerSample]]:
        arrived_s = np.array([arrived_s for arrived_s, _ in self.samples], np.float64)
        return arrived_s, [sample for _, sample in self.samples]


def _hints(report: dict[str, Any], trouble: str, subjects: Counter[str]) -> list[str]:
    """What is wrong with a report, each with what mends it."""
    if not report["frames"]:
        return [trouble] if trouble else ["nothing came; run it longer"]
    hints = [trouble] if trouble else []
    shapes = report["shapes"]
    if report["no_face_ratio"] > 0.1:
        hints.append("the tracker often sees no face: more light, and look at its camera")
    if report["fps"] is not None and report["fps"] < LOW_FPS:
        hints.append(
            f"only {report['fps']:g} samples a second: a cooler phone, or less load, helps"
        )
    if report["gap_ms"].get("max", 0) > LONG_GAP_MS:
        hints.append("gaps above 150 ms: use a cable or 5 GHz Wi-Fi, near to the access point")
    if missing := [name for name in ARKIT_NAMES if name not in shapes]:
        hints.append(f"not sent: {_named(missing)}; they stay at rest")
    constant = [name for name, each in shapes.items() if each["max"] - each["min"] < CONSTANT]
    if len(constant) >= MANY_CONSTANT:
        hints.append(f"never move: {_named(constant)}; make faces while this runs")
    head = report["head"]
    if head and all(each["max"] - each["min"] < CONSTANT for each in head.values()):
        hints.append('the head never turns: switch on "Stream Head Rotation", or the like')
    shifted = [name for name, each in shapes.items() if each["p05"] > SHIFTED_AT_REST]
    if any(not name.startswith(("eyeBlink", "eyeLook")) for name in shifted):
        hints.append(f"never at rest: {_named(shifted)}; `pica calibrate` takes that away")
    if len(subjects) > 1:
        hints.append(f"several faces on this port: {', '.join(subjects)}; name one: livelink/NAME")
    return hints


def _named(shapes: list[str]) -> str:
    """The first of many names, and how many more there are."""
    more = len(shapes) - NAMED_SHAPES
    return ", ".join(shapes[:NAMED_SHAPES]) + (f" and {more} more" if more > 0 else "")


def _range(values: Float64Array) -> dict[str, float]:
    """Mean and limits of what was sent."""
    known = values[~np.isnan(values)]
    low = np.quantile(known, 0.05)
    figures = {"mean": known.mean(), "min": known.min(), "max": known.max(), "p05": low}
    return {name: round(float(value), 4) for name, value in figures.items()}


def _percentiles(seconds: Float64Array) -> dict[str, float]:
    """Median, 95th percentile and largest, in milliseconds."""
    named = {"p50": 50, "p95": 95, "max": 100} if len(seconds) else {}
    return {name: round(1e3 * float(np.percentile(seconds, at)), 3) for name, at in named.items()}
