"""`pica track` and `pica calibrate`: what a tracker sends, and whose face it is."""

import time
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.table import Table

from pica_client.errors import OptionError, SourceError, check_ranges
from pica_client.output import check_writable, say
from pica_client.sources.live.calibration import MAX_GAIN, MAX_SOUND_OFFSET_S
from pica_client.sources.live.calibration import calibrate as calibration_of_samples
from pica_client.sources.live.live_face import TrackerSample
from pica_client.sources.live.recorder import Recorder
from pica_client.sources.live.tracker import SampleTap, Tracker
from pica_client.sources.registry import (
    LIVE_HELP,
    TRACKER_KINDS,
    calibrations,
    open_live,
    split_source,
)
from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.types import FloatArray

REDRAW_S = 0.1
BAR_CELLS = 20
SHOWN_SHAPES = 16


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackOptions:
    """Options of `pica track`."""

    source: str = field(kw_only=False)
    """livelink[:lan][:PORT][/SUBJECT], vmc[:lan][:PORT], ifacialmocap:PHONE_IP,
    facemotion3d:PHONE_IP or webcam[:DEVICE|FILE]; lan listens to other machines, too."""
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
    gain: float = 1.0
    """Stronger movements of all but lids and gaze, 1 to 2: shapes are multiplied by it and stay
    within 1. It makes what the tracker takes for a movement stronger, too."""
    sound_offset: float = 0.0
    """How much later the tracker sees your mouth than the microphone hears it, seconds: raise it
    where the others see your lips move after your voice."""
    wait: float = 30.0
    """How long to wait for the first face, seconds."""


def track(options: TrackOptions) -> dict[str, Any]:
    """Show what a tracker sends: rate, gaps, shapes, head, and what would mend it."""
    check_writable(options.record)
    recorder = Recorder()
    console = Console(stderr=True)
    with closing(_open(options.source, recorder)) as source, ExitStack() as stack:
        say(f"listening for {options.source}; Ctrl-C ends")
        live = None
        if console.is_terminal:
            live = stack.enter_context(Live(console=console, auto_refresh=False, transient=True))
        try:
            end_s = time.monotonic() + (options.seconds or float("inf"))
            while time.monotonic() < end_s:
                time.sleep(REDRAW_S)
                if live is not None:
                    live.update(_bars(recorder, source.trouble), refresh=True)
        except KeyboardInterrupt:
            pass
        trouble = source.trouble
    result = recorder.report(trouble, source.refused, source.subjects)
    result |= {"source": options.source, "sender": getattr(source, "sender", "")}
    if options.record is not None:
        recorder.save(options.record)
    sender = f" from {result['sender']}" if result["sender"] else ""
    say(f"{result['frames']} samples{sender}, {result['fps'] or 0:g} a second")
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
    check_ranges(options, gain=(1, MAX_GAIN), sound_offset=(-limit, limit))
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
        end_s = time.monotonic() + options.wait
        while not samples:
            if time.monotonic() > end_s:
                raise SourceError(source.trouble or "the tracker sees no face")
            time.sleep(REDRAW_S)
        at_rest = gather(options.seconds)
        closed: list[FloatArray] = []
        if options.eyes_closed:
            say("now close both eyes")
            time.sleep(1.0)
            closed = gather(options.eyes_closed)
            say("open them again")
    calibration = replace(
        calibration_of_samples(at_rest, closed),
        gain=options.gain,
        sound_offset_s=options.sound_offset,
    )
    path = calibrations().save(options.name, kind, calibration)
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
        "gain": calibration.gain,
    }


def _open(text: str, tap: SampleTap) -> Tracker:
    kind, rest = split_source(text)
    if kind not in TRACKER_KINDS:
        raise SourceError(f"source {text!r} is no tracker; write {LIVE_HELP}")
    return open_live(kind, rest, tap=tap)


def _bars(recorder: Recorder, trouble: str) -> Table:
    """The shapes that are highest now, as bars."""
    title = trouble or f"{len(recorder.samples)} samples"
    table = Table(title=title, show_header=False, box=None)
    if recorder.samples and recorder.samples[-1][1].has_face:
        values = {
            name: float(value)
            for name, value in zip(ARKIT_NAMES, recorder.samples[-1][1].arkit, strict=True)
            if value == value  # not sent: NaN
        }
        for name in sorted(values, key=lambda each: -values[each])[:SHOWN_SHAPES]:
            cells = round(min(max(values[name], 0.0), 1.0) * BAR_CELLS)
            table.add_row(name, "█" * cells + "·" * (BAR_CELLS - cells), f"{values[name]:.2f}")
    return table
