"""`pica track` and `pica calibrate`: what a tracker sends, and whose face it is."""

import time
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table

from pica_client.errors import OptionError, SourceError, check_ranges
from pica_client.output import check_writable, say
from pica_client.sources.live.calibration import MAX_GAIN, Calibration, sound_offset
from pica_client.sources.live.calibration import calibrate as calibration_of_samples
from pica_client.sources.live.live_face import TrackerSample
from pica_client.sources.live.take import TakeRecorder, TrackReport
from pica_client.sources.live.tracker import SampleTap, Tracker
from pica_client.sources.registry import (
    LIVE_HELP,
    TRACKER_KINDS,
    calibration_of,
    calibrations,
    open_live,
    split_source,
)
from pica_client.voice.packet import FRAME_S, SAMPLE_RATE_HZ
from pica_client.voice.sound.devices import Microphone
from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES
from pica_core.types import FloatArray

REDRAW_S = 0.1
BAR_CELLS = 20
SHOWN_SHAPES = 16
SETTLE_S, PLOSIVE_S = 1.0, 1.2
"""How long a microphone takes to begin, and somebody to say "pa" and wait."""
OPENING = ("jawOpen", "mouthClose")
"""A mouth is open by the first less the second."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackOptions:
    """Options of `pica track`."""

    source: str = field(kw_only=False)
    """livelink[:lan][:PORT][/SUBJECT], vmc[:lan][:PORT], ifacialmocap:PHONE_IP,
    facemotion3d:PHONE_IP or webcam[:DEVICE|FILE]; lan listens to other machines, too."""
    seconds: float = 10.0
    """How long to listen; 0 is until Ctrl-C."""
    record: Path | None = None
    """Keep what came as a take, which take:FILE plays again."""


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
    plosives: int = 0
    """How many times to say "pa" after that, as 5: how much later than the microphone the tracker
    is. It is taken off all that is sent, so that voice and lips fit. 0 leaves it as it was."""
    microphone: str = ""
    """The microphone that hears it; the system's by default."""
    wait: float = 30.0
    """How long to wait for the first face, seconds."""


def track(options: TrackOptions) -> dict[str, Any]:
    """Show what a tracker sends: rate, gaps, shapes, head, and what would mend it."""
    check_writable(options.record)
    report, recorder = TrackReport(options.source), TakeRecorder()

    def tap(sample: TrackerSample, arrived_s: float, process_s: float) -> None:
        report(sample, arrived_s, process_s)
        if options.record is not None:
            recorder(sample, arrived_s, process_s)

    console = Console(stderr=True)
    with closing(_open(options.source, tap)) as source, ExitStack() as stack:
        say(f"listening for {options.source}; Ctrl-C ends")
        live = None
        if console.is_terminal:
            live = stack.enter_context(Live(console=console, auto_refresh=False, transient=True))
        try:
            end_s = time.monotonic() + (options.seconds or float("inf"))
            while time.monotonic() < end_s:
                time.sleep(REDRAW_S)
                if live is not None:
                    live.update(_bars(report, source.trouble), refresh=True)
        except KeyboardInterrupt:
            pass
        trouble = source.trouble
    result = report.to_json(trouble, source.refused, source.subjects)
    result["sender"] = getattr(source, "sender", "")
    if options.record is not None:
        recorder.save(options.record)
    sender = f" from {result['sender']}" if result["sender"] else ""
    say(f"{result['frames']} samples{sender}, {result['fps'] or 0:g} a second")
    for hint in result["hints"]:
        say(f"- {hint}")
    return result


def calibrate(options: CalibrateOptions) -> dict[str, Any]:
    """Learn your face at rest, your closed eyes, and when you are seen, for a tracker.

    `pica send` and `pica view` use it whenever you join under the same name with that tracker.
    """
    if not options.seconds > 0:
        raise OptionError(f"seconds is {options.seconds:g}; above 0 is needed")
    check_ranges(options, gain=(1, MAX_GAIN), plosives=(0, 60))
    kind, _ = split_source(options.source)
    offset_s = (calibration_of(options.name, kind) or Calibration()).sound_offset_s
    samples: list[FloatArray] = []

    def tap(sample: TrackerSample, arrived_s: float, process_s: float) -> None:
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
        if options.plosives:
            offset_s = _sound_offset(source, options)
    calibration = replace(
        calibration_of_samples(at_rest, closed), gain=options.gain, sound_offset_s=offset_s
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
        "sound_offset_ms": round(offset_s * 1e3, 1),
    }


def _sound_offset(source: Tracker, options: CalibrateOptions) -> float:
    """How much later than the microphone the tracker is, from plosives."""
    frames: list[tuple[FloatArray, int]] = []
    opening: list[tuple[float, float]] = []
    microphone = Microphone(options.microphone)
    microphone.on_frame = lambda frame, captured_us: frames.append((frame, captured_us))
    microphone.start()
    try:
        say(f'say "pa" {options.plosives} times: lips closed, "pa", closed again, wait a second')
        end_s = time.monotonic() + SETTLE_S + PLOSIVE_S * options.plosives
        while (now := time.monotonic()) < end_s:
            face = source.frame_at(now)
            if not opening or face.captured_us * 1e-6 > opening[-1][0]:
                jaw, lips = (float(face.arkit[ARKIT_INDEX[name]]) for name in OPENING)
                opening.append((face.captured_us * 1e-6, jaw - lips))
            time.sleep(0.005)
    finally:
        microphone.stop()
    if not frames:
        raise SourceError(f"no microphone: {microphone.state.note or 'it gives no sound'}")
    sound = np.concatenate([frame for frame, _ in frames])
    # Its clock only comes too late, while the machine is busy.
    begin_s = min(us * 1e-6 - index * FRAME_S for index, (_, us) in enumerate(frames))
    offset_s, num_used = sound_offset(opening, sound, begin_s, SAMPLE_RATE_HZ)
    say(f"seen {offset_s * 1e3:.0f} ms after it is heard, by {num_used} plosives")
    return offset_s


def _open(text: str, tap: SampleTap) -> Tracker:
    kind, rest = split_source(text)
    if kind not in TRACKER_KINDS:
        raise SourceError(f"source {text!r} is no tracker; write {LIVE_HELP}")
    return open_live(kind, rest, tap=tap)


def _bars(report: TrackReport, trouble: str) -> Table:
    """The shapes that are highest now, as bars."""
    title = trouble or f"{report.frames} samples"
    table = Table(title=title, show_header=False, box=None)
    if report.last is not None and report.last.has_face:
        values = {
            name: float(value)
            for name, value in zip(ARKIT_NAMES, report.last.arkit, strict=True)
            if value == value  # not sent: NaN
        }
        for name in sorted(values, key=lambda each: -values[each])[:SHOWN_SHAPES]:
            cells = round(min(max(values[name], 0.0), 1.0) * BAR_CELLS)
            table.add_row(name, "█" * cells + "·" * (BAR_CELLS - cells), f"{values[name]:.2f}")
    return table
