"""Where the time of a frame goes, from the tracker's sample to the decoded avatar. Pure."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pica_client.stats import summarise_ms
from pica_protocol.frames import TICK_US


@dataclass(frozen=True, kw_only=True, slots=True)
class FrameTimes:
    """One frame's way through the receiver, seconds on its clock.

    Attributes:
        name: Who sent it.
        captured_us: When the tracker sampled it, on the clock that all processes here share.
        arrived_s: It came off the socket.
        released_s: The playout buffer let it go.
        decoded_s: Its maps are there; waiting for a decoder is counted as decoding.
    """

    name: str
    captured_us: int
    arrived_s: float
    released_s: float
    decoded_s: float


def frame_times(
    shown: Iterable[tuple[str, int, int, int]], decodes: Iterable[tuple[str, int, float, float]]
) -> list[FrameTimes]:
    """The way of each decoded face, from what a viewer logs.

    A face between two frames is a moment that nobody sent; its way is that of the newer frame,
    moved to the moment shown. Both logs are bounded and drop their oldest: a decode whose face is
    no longer known is left out.

    Args:
        shown: Of each face handed to the display: name, moment shown and capture time of its newest
            frame on the sender's clock, arrival of that frame; microseconds.
        decodes: Of each decode: name, moment shown in microseconds, submission and end in seconds.
    """
    ways = {
        (name, shown_us): (captured_us, arrived_us)
        for name, shown_us, captured_us, arrived_us in shown
    }
    frames = []
    for name, shown_us, submitted_s, finished_s in decodes:
        way = ways.get((name, shown_us))
        if way is None:
            continue
        captured_us, arrived_us = way
        earlier_s = (captured_us - shown_us) / 1e6
        frames.append(
            FrameTimes(
                name=name,
                captured_us=captured_us,
                arrived_s=arrived_us / 1e6,
                released_s=submitted_s + earlier_s,
                decoded_s=finished_s + earlier_s,
            )
        )
    return frames


def latency_summary(
    frames: Iterable[FrameTimes], encode_times_s: Mapping[tuple[str, int], float]
) -> dict[str, Any]:
    """Percentiles of the whole way and of its parts, in milliseconds.

    The parts of one frame add up to its whole; percentiles of parts do not add up to that of the
    whole. A frame whose encoding time is not known (its sender crashed) counts for the parts it
    has; its way to us is counted as the relay's.

    Args:
        frames: With capture times as they came over the wire, in steps of `TICK_US`.
        encode_times_s: By name and capture time as the sender has it, microseconds.
    """
    on_wire_s = {
        (name, captured_us // TICK_US * TICK_US): encode_s
        for (name, captured_us), encode_s in encode_times_s.items()
    }
    total: list[float] = []
    parts: dict[str, list[float]] = {"encode": [], "relay": [], "playout": [], "decode": []}
    for frame in frames:
        captured_s = frame.captured_us / 1e6
        encode_s = on_wire_s.get((frame.name, frame.captured_us))
        if encode_s is not None:
            parts["encode"].append(encode_s)
        parts["relay"].append(frame.arrived_s - captured_s - (encode_s or 0.0))
        parts["playout"].append(frame.released_s - frame.arrived_s)
        parts["decode"].append(frame.decoded_s - frame.released_s)
        total.append(frame.decoded_s - captured_s)
    return {
        **summarise_ms(total),
        "parts": {name: summarise_ms(samples) for name, samples in parts.items()},
    }
