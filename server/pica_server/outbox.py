"""What waits for one receiver: every control message, and of each stream the newest frame only.

Bounded by design. Frames: one slot for each stream of the room, where a newer frame replaces a
waiting one, so a receiver that reads slowly gets fewer frames and never an old one. Control: a
queue with a limit in bytes; it is never thinned, a receiver that lets it overflow is closed
instead.
"""

from collections import deque
from typing import NamedTuple

from pica_protocol.frames import media_message
from pica_protocol.limits import MAX_MEDIA_MESSAGE_BYTES
from pica_server.errors import OutboxFullError


class Parcel(NamedTuple):
    """One websocket message on its way out."""

    data: bytes
    received_s: tuple[float, ...]
    """When each of its frames came to the relay; empty for a control message."""


class Outbox:
    """The queue between the room and one receiver's socket."""

    def __init__(self, max_control_bytes: int) -> None:
        self._max_control_bytes = max_control_bytes
        self._control: deque[bytes] = deque()
        self._control_bytes = 0
        self._slots: dict[int, tuple[bytes, float]] = {}

    @property
    def waiting_frames(self) -> int:
        """How many frames wait, at most one of each stream."""
        return len(self._slots)

    @property
    def waiting_control_bytes(self) -> int:
        """How many bytes of control messages wait."""
        return self._control_bytes

    def put_control(self, data: bytes) -> None:
        """Queue a control message.

        Raises:
            OutboxFullError: The receiver has let too many pile up; nothing was queued.
        """
        if self._control_bytes + len(data) > self._max_control_bytes:
            raise OutboxFullError(f"{self._control_bytes} bytes of control messages wait unread")
        self._control.append(data)
        self._control_bytes += len(data)

    def put_frame(self, stream: int, frame: bytes, now: float) -> bool:
        """Put a frame in its stream's slot; return whether it replaced one that still waited."""
        # A replaced frame keeps its stream's place in the line: dict order is the order of waiting.
        replaces = stream in self._slots
        self._slots[stream] = (frame, now)
        return replaces

    def forget_stream(self, stream: int) -> bool:
        """Empty the slot of a stream that has ended; return whether a frame waited there."""
        return self._slots.pop(stream, None) is not None

    def finish(self, last_words: list[bytes]) -> int:
        """Drop the waiting frames, return how many, and queue the last messages whatever the
        limit."""
        dropped = len(self._slots)
        self._slots.clear()
        self._control.extend(last_words)
        self._control_bytes += sum(map(len, last_words))
        return dropped

    def take(self) -> Parcel | None:
        """Take the next message: control first, then as many frames as one message holds."""
        if self._control:
            data = self._control.popleft()
            self._control_bytes -= len(data)
            return Parcel(data, ())
        if not self._slots:
            return None
        room_left = MAX_MEDIA_MESSAGE_BYTES - 1
        taken = []
        for stream, (frame, _) in self._slots.items():
            room_left -= len(frame)
            if room_left < 0:
                break
            taken.append(stream)
        slots = [self._slots.pop(stream) for stream in taken]
        return Parcel(
            media_message(frame for frame, _ in slots), tuple(received for _, received in slots)
        )
