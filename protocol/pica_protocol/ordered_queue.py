"""What of one ordered stream waits for one reader: everything in order, until it is too late.

For tracks whose frames stand alone and lose their worth with time, as voice or events. No frame
refers to another, so any may be dropped; none replaces another, so all wait in order:

1. A frame that has waited longer than the deadline is dropped, the oldest first.
2. At most ``MAX_WAITING_FRAMES`` and ``MAX_WAITING_BYTES`` wait; one more drops the oldest.

Layers and keyframe flags mean nothing here, but a subscription to a lower layer is followed.
Latecomers get what comes from then on. It stands beside `StreamQueue` and takes the same calls.
"""

from collections import Counter, deque
from collections.abc import Sequence
from typing import Final

from pica_protocol.messages import Track
from pica_protocol.stream_queue import Put, StreamQueue, Waiting

MAX_WAITING_FRAMES: Final = 256
"""Frames of a stream that may wait (chosen: five seconds of voice in frames of 20 ms)."""
MAX_WAITING_BYTES: Final = 16_384
"""Bytes of a stream that may wait, headers included (chosen: a second of 128 kbit/s)."""


class OrderedQueue:
    """The bounded queue between one ordered stream and one reader."""

    __slots__ = ("_deadline_s", "_drops", "_is_unwanted", "_waiting", "num_bytes")

    def __init__(self, drops: Counter[str], deadline_s: float) -> None:
        """Begin empty.

        Args:
            drops: Where frames that are dropped are counted, by reason: ``expired`` after the
                deadline, ``overflow`` when too many wait.
            deadline_s: How long a frame may wait.
        """
        self._drops = drops
        self._deadline_s = deadline_s
        self._waiting: deque[Waiting] = deque()
        self._is_unwanted = False
        self.num_bytes = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, frame: bytes, layer: int, is_keyframe: bool, now: float) -> Put:
        """Take the next frame of the stream, header included."""
        if self._is_unwanted:
            return Put.DROPPED
        self.expire(now)
        self._waiting.append(Waiting(frame, layer, now))
        self.num_bytes += len(frame)
        while len(self._waiting) > MAX_WAITING_FRAMES or self.num_bytes > MAX_WAITING_BYTES:
            self._drop_oldest("overflow")
        return Put.WAITS

    def expire(self, now: float) -> None:
        """Drop what has waited longer than the deadline."""
        while self._waiting and now - self._waiting[0].received_s > self._deadline_s:
            self._drop_oldest("expired")

    def want(self, layer: int | None) -> int:
        """Follow a subscription up to ``layer``, or for none; return how many that waited were
        dropped for it. After none, ``resume`` starts again."""
        before = len(self._waiting)
        self._is_unwanted = layer is None
        highest = -1 if layer is None else layer
        self._waiting = deque(item for item in self._waiting if item.layer <= highest)
        self.num_bytes = sum(len(item.frame) for item in self._waiting)
        return before - len(self._waiting)

    def resume(self, chain: Sequence[bytes], *, is_whole: bool, now: float) -> None:
        """Begin again with the next frame: nothing is kept of an ordered stream."""
        self._is_unwanted = False

    def take(self, max_bytes: int) -> list[Waiting]:
        """Take the frames that go out next, in order, as many as ``max_bytes`` hold."""
        taken = []
        while self._waiting and len(self._waiting[0].frame) <= max_bytes:
            item = self._waiting.popleft()
            max_bytes -= len(item.frame)
            self.num_bytes -= len(item.frame)
            taken.append(item)
        return taken

    def _drop_oldest(self, reason: str) -> None:
        self.num_bytes -= len(self._waiting.popleft().frame)
        self._drops[reason] += 1


def queue_for(track: Track, drops: Counter[str]) -> StreamQueue | OrderedQueue:
    """Return the queue that the drop policy of a track asks for."""
    if track.policy == "ordered":
        return OrderedQueue(drops, track.deadline_ms / 1000)
    return StreamQueue(drops)
