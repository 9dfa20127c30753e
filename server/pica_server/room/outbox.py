"""What waits for one receiver: control messages, and frames of the streams that it wants. Pure.

While the receiver keeps up, its frames wait in one list until the turn of the event loop ends, and
leave as one message. A receiver whose socket did not take a message whole is *slow*, and is treated
as such for `SLOW_S` more: its frames wait in a `FrameQueue`, which keeps the newest of each stream
and shares the line fairly by senders. It gives out no more than `SLOW_MESSAGE_BYTES` at once, since
what is on its way cannot be replaced by newer frames.

Control messages are never thinned: there is a limit in bytes, and who lets it overflow is closed.
Whispers are no such messages: they wait and are dropped as ordered frames of their senders.
"""

import math
from collections import Counter, deque
from collections.abc import Sequence
from typing import Final, NamedTuple

from pica_protocol.frame_queue import FrameQueue, QueuedFrame
from pica_protocol.frames import media_message
from pica_protocol.limits import MAX_MEDIA_MESSAGE_BYTES

MAX_CONTROL_BYTES: Final = 262_144
"""Control messages that may wait for one peer before it is closed (chosen: twice the largest)."""
SLOW_S: Final = 5.0
"""How long a receiver counts as slow after its socket was full (chosen)."""
SLOW_MESSAGE_BYTES: Final = 480
"""What a message to a slow receiver holds (chosen: 60 ms of a line of 64 kbit/s, in which a packet
of a voice fits with two sealed faces, or eight faces)."""
WHISPERS: Final = 0
"""Stands for whispers among the streams of a sender."""
WHISPER_S: Final = 10.0
"""How long a whisper may wait (chosen: keys of an encryption are repeated by then)."""
MAX_FRESH: Final = 13
"""Frames that wait unsorted: as many as fit one message; one more, and they are sorted as for a
slow receiver."""


class OutboundMessage(NamedTuple):
    """One websocket message on its way out."""

    data: bytes
    num_frames: int = 0
    received_s: float = 0.0
    """When the first of its frames came to the relay."""


class Outbox:
    """The queue between the room and one receiver's socket.

    Attributes:
        fresh: Frames in the order of their coming. Forwarding appends to it, and calls `sort` when
            there are more than `MAX_FRESH`.
        is_quick: Whether nothing else waits and the receiver is not slow: what is fresh may go out
            without `take`.
    """

    __slots__ = (
        "_control",
        "_drops",
        "_queue",
        "_slow_until_s",
        "fresh",
        "is_quick",
        "waiting_control_bytes",
    )

    def __init__(self, drops: Counter[str]) -> None:
        """Begin empty.

        Args:
            drops: Where frames that are dropped for slowness are counted, by reason.
        """
        self._drops = drops
        self._control: deque[OutboundMessage] | None = None
        self.waiting_control_bytes = 0
        self.fresh: list[QueuedFrame] = []
        self.is_quick = True
        self._queue: FrameQueue | None = None
        self._slow_until_s = -math.inf

    @property
    def waiting_frames(self) -> int:
        """How many frames wait."""
        return len(self.fresh) + (0 if self._queue is None else len(self._queue))

    @property
    def is_waiting(self) -> bool:
        """Whether `take` has something."""
        return bool(self.fresh or self._queue or self._control)

    @property
    def is_urgent(self) -> bool:
        """Whether a control message or a frame of an ordered stream waits."""
        is_ordered = any(frame.deadline_s is not None for frame in self.fresh)
        return bool(self._control) or is_ordered or bool(self._queue and self._queue.has_ordered)

    def is_slow(self, now: float) -> bool:
        """Whether the receiver's socket has been full lately."""
        return now < self._slow_until_s

    def note_full(self, now: float) -> None:
        """Note that the socket of the receiver did not take a message whole."""
        self._slow_until_s = now + SLOW_S
        self.is_quick = False

    def put_control(self, data: bytes) -> bool:
        """Queue a control message; return False, and queue nothing, if the receiver has let too
        many pile up."""
        has_room = self.waiting_control_bytes + len(data) <= MAX_CONTROL_BYTES
        if has_room:
            self._append(OutboundMessage(data))
        return has_room

    def put(self, frame: QueuedFrame) -> None:
        """Queue a frame."""
        self.fresh.append(frame)
        if len(self.fresh) > MAX_FRESH:
            self.sort()

    def put_whisper(self, sender: str, message: bytes, now: float) -> None:
        """Queue a whisper, which shares the line with the frames of its sender."""
        self.sort()
        assert self._queue is not None
        self._queue.put(QueuedFrame(sender, WHISPERS, message, now, WHISPER_S))

    def drop(self, sender: str, stream: int | None = None) -> int:
        """Drop what waits of a sender, or of one of its streams; return how many frames that is."""
        before = self.waiting_frames
        self.fresh = [f for f in self.fresh if f.sender != sender or stream not in (None, f.stream)]
        if self._queue is not None:
            self._queue.drop(sender, stream)
        return before - self.waiting_frames

    def finish(self, last_words: list[bytes]) -> int:
        """Drop the waiting frames, return how many, and queue whispers and the last messages
        whatever the limit."""
        waiting = [] if self._queue is None else self._queue.take(1 << 30, -math.inf)
        whispers = [frame.data for frame in waiting if frame.stream == WHISPERS]
        dropped = len(self.fresh) + len(waiting) - len(whispers)
        self.fresh, self._queue = [], None
        self._append(*(OutboundMessage(data) for data in [*whispers, *last_words]))
        return dropped

    def take(self, now: float) -> OutboundMessage | None:
        """Take the next message: control first, then as many frames as one message holds."""
        if self._control:
            message = self._control.popleft()
            self.waiting_control_bytes -= len(message.data)
            if not self._control:
                self._control = None  # an empty deque takes 760 bytes
            return message
        is_slow = now < self._slow_until_s
        frames: Sequence[QueuedFrame] = self.fresh
        if (is_slow or self._queue is not None) and frames:
            self.sort()
        if self._queue is not None:
            most = SLOW_MESSAGE_BYTES if is_slow else MAX_MEDIA_MESSAGE_BYTES - 1
            frames = self._queue.take(most, now)
            if not len(self._queue):
                self._queue = None
        else:
            self.fresh = []
        self.is_quick = not is_slow and self._queue is None
        if not frames:
            return None
        whispers = [frame.data for frame in frames if frame.stream == WHISPERS]
        frames = [frame for frame in frames if frame.stream != WHISPERS] if whispers else frames
        data = media_message([frame.data for frame in frames])
        message = OutboundMessage(data, len(frames), frames[0].received_s if frames else 0.0)
        if not whispers:
            return message
        self._append(*(OutboundMessage(data) for data in whispers))
        if frames:
            self._append(message)
        return self.take(now)

    def sort(self) -> None:
        """Move the fresh frames into the queue, where newer ones replace older ones."""
        if self._queue is None:
            self._queue = FrameQueue(self._drops)
        for frame in self.fresh:
            self._queue.put(frame)
        self.fresh, self.is_quick = [], False

    def _append(self, *messages: OutboundMessage) -> None:
        """Let messages go out as they are, before all that comes from now on."""
        if self._control is None:
            self._control = deque()
        self._control.extend(messages)
        self.waiting_control_bytes += sum(len(message.data) for message in messages)
        self.is_quick = False
