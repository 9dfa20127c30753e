"""`pica track` and `pica calibrate`: what a tracker sends, and whose face it is.

A recording is a CSV file as Live Link Face saves it, at the times at which samples arrived: the
source ``csv:FILE`` plays it, and other programs read it. Where the head is does not fit into it.
"""

import time
from collections import Counter
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from pica_client.errors import OptionError, SourceError, check_ranges
from pica_client.sources.calibration import MAX_SOUND_OFFSET_S, save_calibration
from pica_client.sources.calibration import calibrate as calibration_of_samples
from pica_client.sources.live_face import TrackerSample, yaw_pitch_roll_from_rotation_vector
from pica_client.sources.registry import LIVE_HELP, TRACKER_KINDS, open_live, split_source
from pica_client.sources.tracker import SampleTap, Tracker
from pica_client.system import check_writable, say
from pica_core.avatar.arkit import ARKIT_NAMES, NUM_ARKIT
from pica_core.files import replacing
from pica_core.livelink import MAX_ROWS, livelink_csv
from pica_core.types import FloatArray

LOW_FPS: Final = 20.0
LONG_GAP_MS: Final = 150.0
CONSTANT: Final = 1e-4
"""A shape that moves by less than this in all the time never moves."""
MANY_CONSTANT: Final = 5
NAMED_SHAPES: Final = 6
"""Names in a hint before it says how many more."""
POLL_S = 0.1
FIRST_FACE_S: Final = 30.0
"""How long a calibration waits for the first face."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackOptions:
    """Options of `pica track`."""

    source: str = field(kw_only=False)
    """livelink[:lan][:PORT], vmc[:lan][:PORT], ifacialmocap:PHONE_IP, facemotion3d:PHONE_IP or
    webcam[:DEVICE|FILE]; lan listens to other machines, too."""
    seconds: float = 10.0
    """How long to listen; 0 is until Ctrl-C."""
    record: Path | None = None
    """Keep what came as a CSV file, which csv:FILE plays again."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrateOptions:
    """Options of `pica calibrate`."""

    source: str = field(kw_only=False)
    """The tracker, as for pica track."""
    name: str
    """Whose face it is: the name that you join calls with."""
    seconds: float = 2.0
    """How long to look at the face at rest."""
    eyes_closed: float = 2.0
    """How long to look at closed eyes after that; 0 leaves it out."""
    sound_offset: float = 0.0
    """How much later the tracker sees your mouth than the microphone hears it, seconds: raise it
    where the others see your lips move after your voice."""


@dataclass(slots=True)
class Recorder:
    """Gathers what a tracker sends, to keep it and to report on it; a `SampleTap`."""

    samples: list[tuple[float, TrackerSample]] = field(default_factory=list)
    """When each arrived, and what it was."""

    def __call__(self, sample: TrackerSample, arrived_s: float) -> None:
        """Keep a sample."""
        if len(self.samples) < MAX_ROWS:
            self.samples.append((arrived_s, sample))

    def save(self, path: Path) -> None:
        """Write the recording; shapes that the tracker does not send are 0.

        Raises:
            SourceError: Nothing was recorded, or the file cannot be written.
        """
        if not self.samples:
            raise SourceError(f"{path}: not written, because nothing was recorded")
        rows = [
            (
                arrived_s - self.samples[0][0],
                [*np.nan_to_num(each.arkit), *yaw_pitch_roll_from_rotation_vector(each.rotation)]
                if each.has_face
                else None,
            )
            for arrived_s, each in self.samples
        ]
        try:
            with replacing(path) as unfinished:
                unfinished.write_text(livelink_csv(rows), encoding="utf-8")
        except OSError as error:
            raise SourceError(f"{path}: cannot be written: {error.strerror}") from error

    def report(self, kind: str, trouble: str, refused: Counter[str]) -> dict[str, Any]:
        """What came, and what would mend it; times in milliseconds, angles in degrees.

        Args:
            kind: The kind of tracker.
            trouble: Why there is no face, as the source says.
            refused: Datagrams that were not the tracker's, by reason.
        """
        gaps_ms = 1000 * np.diff([arrived_s for arrived_s, _ in self.samples])
        seen = [sample for _, sample in self.samples if sample.has_face]
        arkit = np.array([sample.arkit for sample in seen]).reshape(-1, NUM_ARKIT)
        turns = np.degrees([sample.rotation for sample in seen]).reshape(-1, 3)
        count = len(self.samples)
        report = {
            "frames": count,
            "frames_without_face": count - len(seen),
            "fps": round(1000 / float(gaps_ms.mean()), 2) if gaps_ms.any() else None,
            "gap_ms": _figures(gaps_ms, p50=50, p95=95, max=100),
            "no_face_ratio": round(1 - len(seen) / count, 4) if count else None,
            "shapes": {
                name: _figures(values, min=0, p05=5, max=100)
                for name, values in zip(ARKIT_NAMES, arkit.T, strict=True)
                if not np.isnan(values).all()
            },
            "head": {
                name: _figures(turns[:, axis], min=0, max=100)
                for name, axis in (("yaw", 1), ("pitch", 0), ("roll", 2))
                if len(turns)
            },
            "refused": dict(refused),
        }
        return report | {"hints": _hints(report, kind, trouble)}


def _hints(report: dict[str, Any], kind: str, trouble: str) -> list[str]:
    """What is wrong with a report, each with what mends it."""
    if not report["frames"]:
        return [trouble] if trouble else ["nothing came; run it longer"]
    hints = [trouble] if trouble else []
    shapes = report["shapes"]
    if report["no_face_ratio"] > 0.1:
        hints.append("the tracker often sees no face: more light, and look at its camera")
    if report["fps"] is not None and report["fps"] < LOW_FPS:
        helps = "more light" if kind == "webcam" else "a cooler phone"
        hints.append(f"only {report['fps']:g} samples a second: {helps}, or less load, helps")
    if kind != "webcam" and report["gap_ms"].get("max", 0) > LONG_GAP_MS:
        hints.append("gaps above 150 ms: use a cable or 5 GHz Wi-Fi, near to the access point")
    if missing := [name for name in ARKIT_NAMES if name not in shapes]:
        hints.append(f"not sent: {_named(missing)}; they stay at rest")
    constant = [name for name, each in shapes.items() if each["max"] - each["min"] < CONSTANT]
    if len(constant) >= MANY_CONSTANT:
        hints.append(f"never move: {_named(constant)}; make faces while this runs")
    head = report["head"]
    if (
        kind != "webcam"
        and head
        and all(each["max"] - each["min"] < CONSTANT for each in head.values())
    ):
        hints.append('the head never turns: switch on "Stream Head Rotation", or the like')
    return hints


def _named(shapes: list[str]) -> str:
    """The first of many names, and how many more there are."""
    more = len(shapes) - NAMED_SHAPES
    return ", ".join(shapes[:NAMED_SHAPES]) + (f" and {more} more" if more > 0 else "")


def _figures(values: FloatArray, **percentiles: float) -> dict[str, float]:
    """Percentiles of the values that are numbers, by name; nothing where there are none."""
    known = values[~np.isnan(values)]
    named = percentiles if len(known) else {}
    return {name: round(float(np.percentile(known, at)), 4) for name, at in named.items()}


def track(options: TrackOptions) -> dict[str, Any]:
    """Show what a tracker sends: rate, gaps, shapes, head, and what would mend it."""
    check_writable(options.record)
    recorder = Recorder()
    with closing(_open(options.source, recorder)) as source:
        say(f"listening for {options.source}; Ctrl-C ends")
        end_s = time.monotonic() + (options.seconds or float("inf"))
        with suppress(KeyboardInterrupt):
            while time.monotonic() < end_s:
                time.sleep(POLL_S)
        trouble = source.trouble
    kind, _ = split_source(options.source)
    result = recorder.report(kind, trouble, source.refused)
    result |= {"source": options.source, "sender": getattr(source, "sender", "")}
    if options.record is not None:
        recorder.save(options.record)
    sender = f" from {result['sender']}" if result["sender"] else ""
    faceless = result["frames_without_face"]
    without = f", {faceless} without a face" if faceless else ""
    say(f"{result['frames']} samples{sender}{without}, {result['fps'] or 0:g} a second")
    for hint in result["hints"]:
        say(f"- {hint}")
    return result


def calibrate(options: CalibrateOptions) -> dict[str, Any]:
    """Learn your face at rest and your closed eyes, for a tracker.

    `pica send` and `pica view` use it whenever you join under the same name with that tracker.
    """
    if not options.seconds > 0:
        raise OptionError(f"seconds is {options.seconds:g}; above 0 is needed")
    limit = MAX_SOUND_OFFSET_S
    check_ranges(options, sound_offset=(-limit, limit))
    kind, _ = split_source(options.source)
    samples: list[FloatArray] = []

    def tap(sample: TrackerSample, arrived_s: float) -> None:
        if sample.has_face:
            samples.append(sample.arkit)

    def gather(seconds: float) -> list[FloatArray]:
        samples.clear()
        time.sleep(seconds)
        return list(samples)

    with closing(_open(options.source, tap)) as source:
        say("look ahead, relaxed, with open eyes")
        end_s = time.monotonic() + FIRST_FACE_S
        while not samples:
            if time.monotonic() > end_s:
                raise SourceError(source.trouble or "the tracker sees no face")
            time.sleep(POLL_S)
        at_rest = gather(options.seconds)
        closed: list[FloatArray] = []
        if options.eyes_closed:
            say("now close both eyes")
            time.sleep(1.0)
            closed = gather(options.eyes_closed)
            say("open them again")
    found = calibration_of_samples(at_rest, closed)
    calibration = replace(found, sound_offset_s=options.sound_offset)
    path = save_calibration(options.name, kind, calibration)
    taken = {
        name: round(value, 3)
        for name, value in zip(ARKIT_NAMES, calibration.neutral, strict=True)
        if value > 0.02 and not name.startswith(("eyeBlink", "eyeLook"))
    }
    say(f"{len(at_rest)} samples; stored in {path}")
    return {
        "path": str(path),
        "samples": len(at_rest),
        "neutral": taken,
        "lid_open": list(calibration.lid_open),
        "lid_closed": list(calibration.lid_closed),
    }


def _open(text: str, tap: SampleTap) -> Tracker:
    kind, rest = split_source(text)
    if kind not in TRACKER_KINDS:
        raise SourceError(f"source {text!r} is no tracker; write {LIVE_HELP}")
    return open_live(kind, rest, tap=tap)
