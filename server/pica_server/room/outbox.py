"""What waits for one receiver: control messages, and frames of the streams that it wants. Pure.

While the receiver keeps up, its frames wait in one list until the turn of the event loop ends, and
leave as one message. A receiver whose socket did not take a message whole is *slow*, and is treated
as such for `SLOW_S` more: its frames wait in a `FrameQueue`, which keeps the newest of each stream,
shares the line fairly by senders and gives out `SLOW_MESSAGE_BYTES` at once.

Control messages are never thinned: there is a limit in bytes, and who lets it overflow is closed.
"""

import math
from collections import Counter, deque
from collections.abc import Sequence
from typing import Final, NamedTuple, cast

from pica_protocol.frame_queue import FrameQueue, QueuedFrame
from pica_protocol.frames import media_message
from pica_protocol.limits import MAX_MEDIA_MESSAGE_BYTES
from pica_server.errors import OutboxFullError

SLOW_S: Final = 5.0
"""How long a receiver counts as slow after its socket was full (chosen)."""
SLOW_MESSAGE_BYTES: Final = 1200
"""Most of a message to a slow receiver (chosen: one datagram; what is on its way cannot be replaced
by newer frames)."""
MAX_FRESH_BYTES: Final = 4096
"""Frames that wait unsorted; more of them, and they are sorted as for a slow receiver."""


class OutboundMessage(NamedTuple):
    """One websocket message on its way out."""

    data: bytes
    received_s: tuple[float, ...]
    """When each of its frames came to the relay; empty for a control message."""


class ArrivedFrame(QueuedFrame):
    """A frame as it came to the relay."""

    __slots__ = ("_alone",)

    def __init__(
        self, sender: str, stream: int, data: bytes, received_s: float, deadline_s: float | None
    ) -> None:
        super().__init__(sender, stream, data, received_s, deadline_s)
        self._alone: OutboundMessage | None = None

    @property
    def alone(self) -> OutboundMessage:
        """The message that carries this frame and nothing else, the same for all receivers."""
        if self._alone is None:
            self._alone = OutboundMessage(media_message((self.data,)), (self.received_s,))
        return self._alone


class Outbox:
    """The queue between the room and one receiver's socket."""

    __slots__ = (
        "_control",
        "_drops",
        "_fresh",
        "_fresh_bytes",
        "_max_control_bytes",
        "_queue",
        "_slow_until_s",
        "waiting_control_bytes",
    )

    def __init__(self, max_control_bytes: int, drops: Counter[str]) -> None:
        """Begin empty.

        Args:
            max_control_bytes: Control messages that may wait.
            drops: Where frames that are dropped for slowness are counted, by reason.
        """
        self._max_control_bytes = max_control_bytes
        self._drops = drops
        self._control: deque[bytes] | None = None
        self.waiting_control_bytes = 0
        self._fresh: list[ArrivedFrame] = []
        self._fresh_bytes = 0
        self._queue: FrameQueue | None = None
        self._slow_until_s = -math.inf

    @property
    def waiting_frames(self) -> int:
        """How many frames wait."""
        return len(self._fresh) + (0 if self._queue is None else len(self._queue))

    @property
    def is_waiting(self) -> bool:
        """Whether `take` has something."""
        return bool(self._fresh or self._queue or self._control)

    @property
    def is_urgent(self) -> bool:
        """Whether a control message or a frame of an ordered stream waits."""
        is_ordered = any(frame.deadline_s is not None for frame in self._fresh)
        return bool(self._control) or is_ordered or bool(self._queue and self._queue.has_ordered)

    def is_slow(self, now: float) -> bool:
        """Whether the receiver's socket has been full lately."""
        return now < self._slow_until_s

    def note_full(self, now: float) -> None:
        """Note that the socket of the receiver did not take a message whole."""
        self._slow_until_s = now + SLOW_S

    def put_control(self, data: bytes) -> None:
        """Queue a control message.

        Raises:
            OutboxFullError: The receiver has let too many pile up; nothing was queued.
        """
        if self.waiting_control_bytes + len(data) > self._max_control_bytes:
            raise OutboxFullError(
                f"{self.waiting_control_bytes} bytes of control messages wait unread"
            )
        self._queue_control([data])

    def put(self, frame: ArrivedFrame) -> None:
        """Queue a frame."""
        # Once for every frame and receiver: written for speed.
        self._fresh.append(frame)
        self._fresh_bytes += len(frame.data)
        if self._fresh_bytes > MAX_FRESH_BYTES:
            self._sort()

    def drop_stream(self, stream: int) -> int:
        """Drop what waits of a stream that has stopped; return how many frames that is."""
        before = self.waiting_frames
        self._fresh = [frame for frame in self._fresh if frame.stream != stream]
        self._fresh_bytes = sum(len(frame.data) for frame in self._fresh)
        if self._queue is not None:
            self._queue.drop(stream)
        return before - self.waiting_frames

    def finish(self, last_words: list[bytes]) -> int:
        """Drop the waiting frames, return how many, and queue the last messages whatever the
        limit."""
        dropped = self.waiting_frames
        self._fresh, self._fresh_bytes, self._queue = [], 0, None
        self._queue_control(last_words)
        return dropped

    def take(self, now: float) -> OutboundMessage | None:
        """Take the next message: control first, then as many frames as one message holds."""
        if self._control:
            data = self._control.popleft()
            self.waiting_control_bytes -= len(data)
            return OutboundMessage(data, ())
        frames: Sequence[QueuedFrame] = self._fresh
        is_slow = now < self._slow_until_s
        if is_slow or self._queue is not None:
            if frames:
                self._sort()
            if self._queue is None:
                return None
            most = SLOW_MESSAGE_BYTES if is_slow else MAX_MEDIA_MESSAGE_BYTES - 1
            frames = self._queue.take(most, now)
            if not len(self._queue):
                self._queue = None
        elif frames:
            self._fresh, self._fresh_bytes = [], 0
            if len(frames) == 1:  # nearly always
                return cast(ArrivedFrame, frames[0]).alone
        if not frames:
            return None
        return OutboundMessage(
            media_message([frame.data for frame in frames]),
            tuple([frame.received_s for frame in frames]),
        )

    def _sort(self) -> None:
        """Move the fresh frames into the queue, where newer ones replace older ones."""
        queue = self._queue
        if queue is None:
            queue = self._queue = FrameQueue(self._drops)
        for frame in self._fresh:
            queue.put(frame)
        self._fresh, self._fresh_bytes = [], 0

    def _queue_control(self, messages: list[bytes]) -> None:
        if self._control is None:
            self._control = deque()
        self._control.extend(messages)
        self.waiting_control_bytes += sum(map(len, messages))
