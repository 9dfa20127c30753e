"""One stream of one face through one trouble, on a virtual clock: what comes when, and what a
playout policy then shows. Pure: no socket, no sleep; the same seed gives the same result.

    delivery = deliver(face, encoder, scenario, seconds)     sender, relay, network
    ticks = play(delivery, decoder, Playout())               decoder, playout, display

The trouble lasts from the end of the first third of the run to the end of the second. The
frames that come do not depend on the policy, so all policies are given the very same ones.

The relay is the real one's decision (`pica_protocol.frame_queue`: of a face the newest frame waits)
in front of a modelled way (`impairment`). While the way takes no more, up to `queue_bytes` wait in
front of it, first in, first out; the rest waits in the relay, and what waits there together leaves
as one message. A voice shares the way with its face, leaves first, and takes along what waits of
the face; while it speaks, the face waits for its next packet (`RIDE_S`), as at the real sender.

Unrealistic: code takes no time; the display never misses a refresh; no peer joins late; the
receiver asks for no other share of the stream when the rate falls short; the sender's own way to
the relay is perfect; a message carries the frames of one person only.
"""

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pica_client.bench.impairment import CALM, Impairment, Scenario, Way
from pica_client.playout.buffer import PlayedFace, Playout, PlayoutReport
from pica_client.stats import wire_bytes
from pica_core.avatar.arkit import ExpressionFrame
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder
from pica_protocol.client_session import RIDE_S
from pica_protocol.frame_queue import FrameQueue, QueuedFrame
from pica_protocol.frames import SEQUENCE_MODULUS, Frame, decode_media, encode_frame, media_message
from pica_protocol.limits import MAX_MEDIA_MESSAGE_BYTES

MAX_UNDER_WAY = 4096
"""Messages on the way; beyond it the oldest is dropped."""

VOICE_DEADLINE_S = 0.2
"""Age beyond which the relay drops a voice packet."""
Face = Callable[[float], ExpressionFrame]
"""The true face at a moment of the sender's clock, seconds."""

FACE_STREAM, VOICE_STREAM = 1, 2
CLOCK_OFFSET_US = 5_000_000_000
"""The sender's clock is ahead of the receiver's: nothing may depend on the difference."""
FPS, DISPLAY_HZ = 30.0, 60.0
"""Frames captured, and refreshes of the display, a second."""
DISPLAY_PHASE = 0.37
"""Where in its own period the display's first refresh lies: not in step with the sender."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Delivery:
    """What came over the network."""

    faces: tuple[tuple[float, Frame], ...]
    """Frames that came, each with its time of arrival."""
    voices: tuple[tuple[float, Frame], ...]
    """Voice packets that came, each with its time of arrival."""
    seconds: float
    """Length of the run."""

    def is_troubled(self, now: float) -> bool:
        """Whether a moment lies in the trouble, the middle third of the run."""
        return self.seconds / 3 <= now < 2 * self.seconds / 3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Tick:
    """One refresh of the display. Times are the receiver's clock, which runs with the true one."""

    now_s: float
    played: PlayedFace | None
    """None before the first frame is due."""
    heard_us: int | None
    report: PlayoutReport


class _Message(NamedTuple):
    data: bytes
    num_bytes: int
    offered_s: float


class FramePath:
    """The way of one stream's frames.

    Attributes:
        drops: Frames that the relay dropped because the way is too slow, by reason.
    """

    def __init__(self, impairment: Impairment, rng: np.random.Generator) -> None:
        self.drops: Counter[str] = Counter()
        self._way = Way(impairment, rng)
        self._relay = FrameQueue(self.drops)
        self._newest_us = 0
        self._queue: deque[_Message] = deque()  # behind the relay; bounded by `queue_bytes`
        self._queue_bytes = 0
        self._ride_ends_s = self._advanced_s = -math.inf
        self._under_way: deque[tuple[float, bytes]] = deque(maxlen=MAX_UNDER_WAY)

    def change(self, impairment: Impairment, now: float) -> None:
        """Let the way be another from now on; what waits leaves at the new rate."""
        self._advance(now)
        self._way.change(impairment)

    def send(self, frame: Frame, now: float) -> None:
        """Offer a frame to the relay, which lets a voice go first and drops it when it is old."""
        self._advance(now)
        deadline_s = VOICE_DEADLINE_S if frame.stream == VOICE_STREAM else None
        self._newest_us = max(self._newest_us, frame.captured_us)
        self._relay.put(QueuedFrame("", frame.stream, encode_frame(frame), now, deadline_s))
        self._advance(now)

    def arrivals(self, now: float) -> list[tuple[float, Frame]]:
        """Take all frames that have come, with the time, in the order of arrival."""
        self._advance(now)
        arrived = []
        while self._under_way and self._under_way[0][0] <= now:
            arrival_s, data = self._under_way.popleft()
            arrived += [
                (arrival_s, frame) for frame in decode_media(data, lambda _: self._newest_us)
            ]
        return arrived

    def _advance(self, now: float) -> None:
        """Move what can move up to now: relay -> queue -> way."""
        # What waited for a voice that did not come left when the wait was over.
        self._fill_queue(min(max(self._ride_ends_s, self._advanced_s), now))
        self._fill_queue(now)
        self._advanced_s = now
        while self._queue and self._way.free_s <= now:
            message = self._queue.popleft()
            self._queue_bytes -= message.num_bytes
            leaves_s = max(self._way.free_s, message.offered_s)
            arrival_s = self._way.transmit(message.num_bytes, leaves_s)
            self._under_way.append((arrival_s, message.data))
            self._fill_queue(leaves_s)

    def _fill_queue(self, now: float) -> None:
        """Let the relay write while its socket takes it."""
        relay = self._relay
        while (relay.has_ordered or (len(relay) and now >= self._ride_ends_s)) and (
            not self._queue or self._queue_bytes < self._way.impairment.queue_bytes
        ):
            if relay.has_ordered:
                self._ride_ends_s = now + RIDE_S
            frames = [frame.data for frame in relay.take(MAX_MEDIA_MESSAGE_BYTES - 1, now)]
            if not frames:
                return
            data = media_message(frames)
            num_bytes = wire_bytes(len(data), is_masked=False)
            self._queue.append(_Message(data, num_bytes, now))
            self._queue_bytes += num_bytes


def deliver(
    face: Face,
    encoder: LatentEncoder,
    scenario: Scenario,
    seconds: float,
    voice: Sequence[tuple[float, Frame]] = (),
) -> Delivery:
    """Send a face through a scenario.

    Args:
        encoder: A fresh one.
        scenario: The trouble in the middle third.
        voice: Packets of a voice that goes along, of `VOICE_STREAM`, each with the time when it is
            sent, in order.
    """
    path = FramePath(CALM, np.random.default_rng(0))
    came: dict[int, list[tuple[float, Frame]]] = {FACE_STREAM: [], VOICE_STREAM: []}
    spoken = deque(voice)
    sent = 0
    changes = [(seconds / 3, scenario.trouble), (2 * seconds / 3, CALM)]

    def receive(until_s: float) -> None:
        for arrived_s, frame in path.arrivals(until_s):
            came[frame.stream].append((arrived_s, frame))

    for index in range(round(seconds * FPS)):
        now = index / FPS
        while spoken and spoken[0][0] <= now:
            sent_s, packet = spoken.popleft()
            receive(sent_s)
            path.send(packet, sent_s)
        receive(now)
        if changes and changes[0][0] <= now:
            path.change(changes.pop(0)[1], now)
        true = face(now)
        captured_us = CLOCK_OFFSET_US + round(now * 1e6)
        coded = encoder.encode(true.arkit, true.rotation, true.translation_m, captured_us)
        if coded is None:
            continue
        frame = Frame(
            stream=FACE_STREAM,
            sequence=sent % SEQUENCE_MODULUS,
            captured_us=captured_us,
            payload=coded.payload,
        )
        path.send(frame, now)
        sent += 1
    receive(seconds)
    return Delivery(
        faces=tuple(came[FACE_STREAM]), voices=tuple(came[VOICE_STREAM]), seconds=seconds
    )


def play(
    delivery: Delivery,
    decoder: LatentDecoder,
    playout: Playout,
    heard_us: Callable[[float], int | None] = lambda now: None,
) -> list[Tick]:
    """Show what came on a display.

    Args:
        decoder: A fresh one, as is the buffer.
        heard_us: The moment of the voice that is heard at a refresh; asked in order.

    Returns:
        All refreshes of the run.
    """
    ticks: list[Tick] = []
    waiting = deque(delivery.faces)
    for index in range(int(delivery.seconds * DISPLAY_HZ)):
        now = (index + DISPLAY_PHASE) / DISPLAY_HZ
        while waiting and waiting[0][0] <= now:
            arrived_s, frame = waiting.popleft()
            playout.receive(frame, decoder.decode(frame.payload), arrived_s)
        heard = heard_us(now)
        played = playout.sample_at(now, heard)
        ticks.append(Tick(now_s=now, played=played, heard_us=heard, report=playout.report()))
    return ticks
