"""Sender, relay and receiver of one stream of frames, as a model. Pure: `now` is an argument.

The relay is the real one's decision (`pica_protocol.frame_queue`: of a face the newest frame waits)
in front of a modelled way (`impairment`). While the way takes no more, up to `queue_bytes` wait in
front of it, first in, first out; the rest waits in the relay, and what waits there together leaves
as one message.

`thin_ratio` stands for whatever else makes a relay drop frames, as the congestion of other streams.

A voice shares the way with its face, leaves first, and takes along what waits of the face; while
it speaks, the face waits for its next packet (`RIDE_S`), as at the real sender.

Unrealistic: the sender's own way to the relay is perfect; a message carries the frames of one
stream only, where a relay puts those of several senders together.
"""

import heapq
import math
from collections import Counter, deque
from typing import NamedTuple

import numpy as np

from pica_client.bench.network.impairment import Impairment, Way
from pica_client.stats import wire_bytes
from pica_protocol.client_session import RIDE_S
from pica_protocol.frame_queue import FrameQueue, QueuedFrame
from pica_protocol.frames import Frame, decode_media, encode_frame, media_message
from pica_protocol.limits import MAX_MEDIA_MESSAGE_BYTES

MAX_UNDER_WAY = 4096
"""Messages on the way; beyond it the newest is dropped."""

VOICE_DEADLINE_S = 0.2
"""Age beyond which the relay drops a voice packet."""


class _Message(NamedTuple):
    data: bytes
    num_frames: int
    num_bytes: int
    offered_s: float


class FramePath:
    """The way of one stream's frames.

    Attributes:
        wire_bytes: What left the relay, with all headers.
        counts: Frames that were ``sent``, ``thinned`` to reach `thin_ratio`, or ``lost`` as
            datagrams.
        drops: Frames that the relay dropped because the way is too slow, by reason.
    """

    def __init__(self, impairment: Impairment, rng: np.random.Generator) -> None:
        self.wire_bytes = 0
        self.counts: Counter[str] = Counter()
        self.drops: Counter[str] = Counter()
        self._way = Way(impairment, rng)
        self._rng = rng
        self._relay = FrameQueue(self.drops)
        self._newest_us = 0
        self._queue: deque[_Message] = deque()  # behind the relay; bounded by `queue_bytes`
        self._queue_bytes = 0
        self._ride_ends_s = self._advanced_s = -math.inf
        self._order = 0
        # Bounded by MAX_UNDER_WAY: (arrival, order, message).
        self._under_way: list[tuple[float, int, bytes]] = []

    def change(self, impairment: Impairment, now: float) -> None:
        """Let the way be another from now on; what waits leaves at the new rate."""
        self._advance(now)
        self._way.change(impairment)

    def send(self, frame: Frame, now: float) -> None:
        """Offer a frame to the relay."""
        self._advance(now)
        self.counts["sent"] += 1
        if self._rng.random() < self._way.impairment.thin_ratio:
            self.counts["thinned"] += 1
        else:
            self._offer(frame, None, now)

    def send_voice(self, frame: Frame, now: float) -> None:
        """Offer a voice packet to the relay, which lets it go first and drops it when it is old."""
        self._advance(now)
        self._offer(frame, VOICE_DEADLINE_S, now)

    def _offer(self, frame: Frame, deadline_s: float | None, now: float) -> None:
        self._newest_us = max(self._newest_us, frame.captured_us)
        self._relay.put(QueuedFrame("", frame.stream, encode_frame(frame), now, deadline_s))
        self._advance(now)

    def arrivals(self, now: float) -> list[tuple[float, Frame]]:
        """Take all frames that have come, with the time, in the order of arrival."""
        self._advance(now)
        arrived = []
        while self._under_way and self._under_way[0][0] <= now:
            arrival_s, _, data = heapq.heappop(self._under_way)
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
            self._transmit(message, leaves_s)
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
            self._queue.append(_Message(data, len(frames), num_bytes, now))
            self._queue_bytes += num_bytes
            self.wire_bytes += num_bytes

    def _transmit(self, message: _Message, now: float) -> None:
        doubles = bool(self._rng.random() < self._way.impairment.duplicate_ratio)
        for _ in range(1 + doubles):
            arrival_s = self._way.transmit(message.num_bytes, now)
            if arrival_s is None or len(self._under_way) >= MAX_UNDER_WAY:
                self.counts["lost"] += message.num_frames
                continue
            self._order += 1
            heapq.heappush(self._under_way, (arrival_s, self._order, message.data))
