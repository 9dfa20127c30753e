"""One stream of one face through one trouble, on a virtual clock: what comes when, and what a
playout policy then shows. Pure: no socket, no sleep; the same seed gives the same result.

    delivery = deliver(face, ends, scenario, schedule, seed=0)      sender, relay, network, decoder
    ticks = play(delivery, Playout(config), schedule)               playout and display

The trouble lasts from the end of the first third of the schedule to the end of the second. The
frames that come do not depend on the policy, so all policies are given the very same ones.

Unrealistic: code takes no time; the display never misses a refresh; no peer joins late; the
receiver asks for no other share of the stream when the rate falls short.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pica_client.bench.network.frame_path import FramePath
from pica_client.bench.network.scenarios import Scenario
from pica_client.errors import check_ranges
from pica_client.playout.buffer import PlayedFace, Playout, PlayoutReport
from pica_client.playout.sender_clock import SenderClock
from pica_core.codec.latent_stream import DecodedFrame, LatentDecoder, LatentEncoder, LatentSample
from pica_protocol.frames import SEQUENCE_MODULUS, Frame

Face = Callable[[float], LatentSample]
"""The true face at a moment of the sender's clock, seconds."""

VOICE_STREAM = 2
"""The stream of a voice beside the face's, which is 1."""
CLOCK_OFFSET_US = 5_000_000_000
"""The sender's clock is ahead of the receiver's: nothing may depend on the difference."""
DISPLAY_PHASE = 0.37
"""Where in its own period the display's first refresh lies: not in step with the sender."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Schedule:
    """How long, how often."""

    seconds: float = 30.0
    """Length of each run; the trouble lasts the middle third of it."""
    fps: float = 30.0
    """Frames captured a second."""
    display_hz: float = 60.0
    """Refreshes of the display a second."""

    def __post_init__(self) -> None:
        check_ranges(self, seconds=(3, 600), fps=(1, 240), display_hz=(10, 240))

    @property
    def begin_s(self) -> float:
        """When the trouble begins."""
        return self.seconds / 3

    @property
    def end_s(self) -> float:
        """When the trouble ends."""
        return 2 * self.seconds / 3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Delivery:
    """What came over the network."""

    arrivals: tuple[DecodedFrame, ...]
    """What could be decoded, in the order of arrival."""
    counts: Mapping[str, int]
    """Frames that were sent, thinned, dropped and lost."""
    payload_bytes: int
    """What was sent."""
    wire_bytes: int
    """What went on to the receiver, with all headers."""
    base_delay_s: float
    """The fastest way through the network."""
    voices: tuple[tuple[float, Frame], ...] = ()
    """Voice packets that came, each with its time of arrival."""

    def samples(self) -> dict[int, LatentSample]:
        """The face of each capture time, microseconds of the sender's clock."""
        return {arrival.captured_us: arrival.sample for arrival in self.arrivals}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Tick:
    """One refresh of the display. Times are the receiver's clock, which runs with the true one."""

    now_s: float
    played: PlayedFace | None
    """None before the first frame is due."""
    report: PlayoutReport

    @property
    def shown_s(self) -> float:
        """When the face that is shown was captured; not defined before the first one."""
        if self.played is None:
            raise ValueError("nothing is shown yet")
        return (self.played.captured_us - CLOCK_OFFSET_US) / 1e6


def deliver(
    face: Face,
    ends: tuple[LatentEncoder, LatentDecoder],
    scenario: Scenario,
    schedule: Schedule,
    *,
    seed: int = 0,
    voice: Sequence[tuple[float, Frame]] = (),
) -> Delivery:
    """Send a face through a scenario and decode what comes.

    Args:
        ends: Both ends of a codec, fresh.
        scenario: The trouble in the middle third.
        voice: Packets of a voice that goes along, of `VOICE_STREAM`, each with the time when it is
            sent, in order.
    """
    encoder, decoder = ends
    sender = SenderClock()
    rng = np.random.default_rng(seed)
    path = FramePath(scenario.calm, rng)
    arrivals: list[DecodedFrame] = []
    voices: list[tuple[float, Frame]] = []
    spoken = deque(voice)
    sent = payload_bytes = 0
    changes = [(schedule.begin_s, scenario.trouble), (schedule.end_s, scenario.calm)]

    def receive(until_s: float) -> None:
        for arrived_s, frame in path.arrivals(until_s):
            if frame.stream == VOICE_STREAM:
                voices.append((arrived_s, frame))
                continue
            received = sender.receive(frame, arrived_s)
            arrivals.append(received.decoded(decoder.decode(received.payload)))

    for index in range(round(schedule.seconds * schedule.fps)):
        now = index / schedule.fps
        while spoken and spoken[0][0] <= now:
            sent_s, packet = spoken.popleft()
            receive(sent_s)
            path.send_voice(packet, sent_s)
        receive(now)
        if changes and changes[0][0] <= now:
            path.change(changes.pop(0)[1], now)
        true = face(now)
        captured_us = CLOCK_OFFSET_US + round(now * 1e6)
        coded = encoder.encode(true.latent, true.rotation, true.translation_m, captured_us)
        if coded is None:
            continue
        frame = Frame(
            stream=1,
            sequence=sent % SEQUENCE_MODULUS,
            captured_us=captured_us,
            payload=coded.payload,
        )
        path.send(frame, now)
        sent += 1
        payload_bytes += len(coded.payload)
    receive(schedule.seconds)
    return Delivery(
        arrivals=tuple(arrivals),
        counts={
            **{name: path.counts[name] for name in ("sent", "thinned", "lost")},
            "dropped": path.drops.total(),
        },
        payload_bytes=payload_bytes,
        wire_bytes=path.wire_bytes,
        base_delay_s=scenario.calm.delay_s,
        voices=tuple(voices),
    )


def play(delivery: Delivery, playout: Playout, schedule: Schedule) -> list[Tick]:
    """Show what came on a display.

    Args:
        playout: A fresh buffer.

    Returns:
        All refreshes of the run.
    """
    samples = delivery.samples()
    ticks: list[Tick] = []
    position = 0
    for index in range(int(schedule.seconds * schedule.display_hz)):
        now = (index + DISPLAY_PHASE) / schedule.display_hz
        while position < len(delivery.arrivals) and delivery.arrivals[position].arrived_s <= now:
            receive_arrival(playout, delivery.arrivals[position], samples)
            position += 1
        played = playout.sample_at(now)
        ticks.append(Tick(now_s=now, played=played, report=playout.report()))
    return ticks


def receive_arrival(
    playout: Playout, arrival: DecodedFrame, samples: Mapping[int, LatentSample]
) -> None:
    """Give a face that came to a playout.

    Args:
        samples: As from `Delivery.samples`.
    """
    sequence = arrival.number % SEQUENCE_MODULUS
    frame = Frame(stream=1, sequence=sequence, captured_us=arrival.captured_us, payload=b"")
    received = playout.sender.receive(frame, arrival.arrived_s)
    playout.receive_frame(received.decoded(samples[received.captured_us]))
