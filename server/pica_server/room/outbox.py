"""What waits for one receiver: every control message, and of each stream what is fresh.

Bounded by design. Frames: a queue for each stream of the room (`pica_protocol.stream_queue` and
`pica_protocol.ordered_queue` say what is dropped, and in which order), so a receiver that reads
slowly gets fewer frames, never a stale one for long, and never one it cannot decode. Control: a
queue with a limit in bytes; it is never thinned, a receiver that lets it overflow is closed.

While a receiver keeps up, nothing is ever dropped from those queues. Streams whose queue is clear
*flow*: their frames wait in one list for all of them, which the next message empties. When the list
is full, or anything else is asked of a stream, its frames move into its queue, and from there on
all is as if they had always been there.

Frames of ordered streams, voices, go first and take along all that waits. Nothing waits for more,
except where that saves what is short, as what surrounds a message (48 bytes with TCP/IP) is more
than a face:

1. A receiver whose socket did not take a message at once is *narrow* for `NARROW_S`. While somebody
   speaks, faces wait for the next packet of the voice, `RIDE_S` at most. Faces alone come only
   every `NARROW_RIDE_S`, and beside a voice no more than `YIELDING_BYTES` of them, none once it is
   late: what does not fit is thinned in the queues. A face that is larger saves up for its turn
   (deficit round robin, Shreedhar and Varghese 1995).
2. While the core of the relay is full (`Brake.is_full`), faces wait for the next packet of a voice,
   too: a message costs more than a frame.
"""

import math
from collections import Counter, deque
from collections.abc import Sequence
from typing import Final, NamedTuple

from pica_protocol.client_session import RIDE_S
from pica_protocol.frames import FLAG_KEYFRAME, media_message
from pica_protocol.limits import MAX_MEDIA_MESSAGE_BYTES
from pica_protocol.ordered_queue import OrderedQueue
from pica_protocol.stream_queue import Put, StreamQueue, Waiting
from pica_server.errors import OutboxFullError
from pica_server.room.brake import Brake

MAX_FLOWING_FRAMES: Final = 4
"""Frames of each flowing stream that may wait in the list, on average: one more than the upper
frames that wait in a queue (chosen)."""
MAX_FLOWING_BYTES: Final = 4096
"""Bytes of all of them: one message, which a slow line has to carry before what is newer."""
NARROW_S: Final = 5.0
"""How long a receiver counts as narrow after its socket was full (chosen)."""
NARROW_MEMORY_S: Final = 120.0
"""Who was narrow so lately may be again (chosen: receivers wait up to 64 s before they ask for
more)."""
NARROW_RIDE_S: Final = 0.05
"""Between two messages of faces alone to a narrow receiver (chosen: three faces fit 24 kbit/s)."""
YIELDING_BYTES: Final = 160
"""What faces take of a message with a voice to a narrow receiver (chosen: base layers of a few)."""
LATE_S: Final = 0.06
"""Age of a packet of a voice beside which a narrow receiver gets no faces (chosen: two pairs)."""
_WAITS = Put.WAITS


class OutboundMessage(NamedTuple):
    """One websocket message on its way out."""

    data: bytes
    received_s: tuple[float, ...]
    """When each of its frames came to the relay; empty for a control message."""


class ArrivedFrame:
    """One frame as all its receivers share it.

    Attributes:
        is_keyframe: Whether it can be decoded alone.
    """

    __slots__ = ("_alone", "data", "is_keyframe", "layer", "received_s", "stream")

    def __init__(self, stream: int, data: bytes, layer: int, flags: int, received_s: float) -> None:
        self.stream = stream
        self.data = data
        self.layer = layer
        self.is_keyframe = layer == 0 and bool(flags & FLAG_KEYFRAME)
        self.received_s = received_s
        self._alone: OutboundMessage | None = None

    @property
    def alone(self) -> OutboundMessage:
        """The message that carries this frame and nothing else."""
        if self._alone is None:
            self._alone = OutboundMessage(media_message((self.data,)), (self.received_s,))
        return self._alone


class Outbox:
    """The queue between the room and one receiver's socket."""

    def __init__(
        self,
        max_control_bytes: int,
        drops: Counter[str],
        *,
        flows: bool = True,
        brake: Brake | None = None,
    ) -> None:
        """Begin empty.

        Args:
            max_control_bytes: Control messages that may wait.
            drops: Where frames that are dropped for slowness are counted, by reason.
            flows: Whether streams may flow; if not, every frame goes through its queue.
            brake: Knows whether the core of the relay is full; by default it never is.
        """
        self._max_control_bytes = max_control_bytes
        self._drops = drops
        self._may_flow = flows
        self._brake = brake or Brake()
        self._control: deque[bytes] = deque()
        self.waiting_control_bytes = 0
        self._queues: dict[int, StreamQueue | OrderedQueue] = {}
        self._ordered: dict[int, OrderedQueue] = {}
        # Streams with something in their queue; dict order is the order of waiting.
        self._line: dict[int, None] = {}
        self._voices: dict[int, None] = {}  # the same of ordered streams
        self._ride_ends_s = self._narrow_until_s = -math.inf
        self._flowing: dict[int, StreamQueue] = {}
        self._flow: list[ArrivedFrame] = []
        self._flow_bytes = 0
        self._saved_bytes = 0  # what faces were left beside voices while the next did not fit

    @property
    def waiting_frames(self) -> int:
        """How many frames wait, at most a few of each stream."""
        return sum(map(len, self._queues.values())) + len(self._flow)

    @property
    def is_waiting(self) -> bool:
        """Whether `take` may have something."""
        return bool(self._flow or self._line or self._voices or self._control)

    def due_s(self, now: float) -> float:
        """When what waits is to go: now, or later if it shares a message with what is to come."""
        ends_s = self._ride_ends_s
        if ends_s <= now or self._voices or self._control:
            return now
        return ends_s

    def note_full(self, now: float) -> None:
        """Note that the socket of the receiver did not take a message at once."""
        self._narrow_until_s = now + NARROW_S

    def takes_chain(self, num_bytes: int, now: float) -> bool:
        """Whether what was kept of a stream is better than to wait for a keyframe: not where voices
        would wait behind it."""
        was_narrow = now < self._narrow_until_s + NARROW_MEMORY_S
        return num_bytes <= YIELDING_BYTES or not (self.has_voices and was_narrow)

    @property
    def has_voices(self) -> bool:
        """Whether there are ordered streams for this receiver."""
        return bool(self._ordered)

    def put_control(self, data: bytes) -> None:
        """Queue a control message.

        Raises:
            OutboxFullError: The receiver has let too many pile up; nothing was queued.
        """
        if self.waiting_control_bytes + len(data) > self._max_control_bytes:
            raise OutboxFullError(
                f"{self.waiting_control_bytes} bytes of control messages wait unread"
            )
        self._control.append(data)
        self.waiting_control_bytes += len(data)

    def put(self, frame: ArrivedFrame) -> Put:
        """Queue a frame, or drop it, and what it replaces; see `StreamQueue.put`."""
        # Once for every frame and receiver: written for speed.
        flowing, flow = self._flowing, self._flow
        if frame.stream not in flowing:
            return self._put_queue(frame)
        num_bytes = self._flow_bytes + len(frame.data)
        if num_bytes > MAX_FLOWING_BYTES or len(flow) >= MAX_FLOWING_FRAMES * len(flowing):
            for stream in list(flowing):
                self._stop_flow(stream)
            return self._put_queue(frame)
        flow.append(frame)
        self._flow_bytes = num_bytes
        return _WAITS

    def _put_queue(self, frame: ArrivedFrame) -> Put:
        stream = frame.stream
        queue = self._queue(stream)
        fate = queue.put(frame.data, frame.layer, frame.is_keyframe, frame.received_s)
        if fate is _WAITS:
            # Where it stands already if something of it waited.
            (self._voices if stream in self._ordered else self._line)[stream] = None
        return fate

    def open_ordered(self, stream: int, deadline_s: float) -> None:
        """Note that a stream is ordered, if that is news."""
        if stream not in self._ordered:
            self._queues[stream] = self._ordered[stream] = OrderedQueue(self._drops, deadline_s)

    def interrupt(self, stream: int) -> int:
        """Drop what waits of a stream that pauses; return how many frames that is.

        It goes on with a keyframe, or, if it is ordered, with any frame.
        """
        queue = self._stop_flow(stream)
        dropped = queue.want(None)
        if isinstance(queue, OrderedQueue):
            queue.resume((), is_whole=True, now=0.0)
        return dropped

    def want(self, stream: int, layer: int | None) -> int:
        """Follow a layer subscription; return how many waiting frames were dropped for it."""
        return self._stop_flow(stream).want(layer)

    def resume(self, stream: int, chain: Sequence[bytes], *, is_whole: bool, now: float) -> int:
        """Queue what was kept of a stream that the receiver begins to read, or reads again.

        Returns:
            How many frames that is; see `StreamQueue.resume`.
        """
        queue = self._stop_flow(stream)
        queue.resume(chain, is_whole=is_whole, now=now)
        if stream not in self._ordered:
            self._line[stream] = None
        return len(queue)

    def forget_stream(self, stream: int) -> int:
        """Forget a stream that has ended; return how many of its frames waited."""
        num_waiting = len(self._stop_flow(stream))
        self._line.pop(stream, None)
        self._voices.pop(stream, None)
        self._ordered.pop(stream, None)
        del self._queues[stream]
        return num_waiting

    def finish(self, last_words: list[bytes]) -> int:
        """Drop the waiting frames, return how many, and queue the last messages whatever the
        limit."""
        dropped = self.waiting_frames
        self._flow_bytes = 0
        self._flow = []
        for emptied in (self._flowing, self._queues, self._ordered, self._line, self._voices):
            emptied.clear()
        self._control.extend(last_words)
        self.waiting_control_bytes += sum(map(len, last_words))
        return dropped

    def take(self, now: float = -math.inf) -> OutboundMessage | None:
        """Take the next message: control first, then as many frames as one message holds, voices
        before faces.

        Frames of ordered streams that are too old by ``now`` are dropped.
        """
        if self._control:
            data = self._control.popleft()
            self.waiting_control_bytes -= len(data)
            return OutboundMessage(data, ())
        room_left = MAX_MEDIA_MESSAGE_BYTES - 1
        voices = self._take_voices(room_left, now) if self._voices else []
        is_narrow = now < self._narrow_until_s
        if voices:
            if is_narrow or self._brake.is_full:
                self._ride_ends_s = now + RIDE_S
            room_left -= sum([len(item.frame) for item in voices])
            if is_narrow:
                is_late = now - min([item.received_s for item in voices]) > LATE_S
                room_left = 0 if is_late else min(room_left, YIELDING_BYTES + self._saved_bytes)
                if self._line or self._flow_bytes > room_left:
                    for stream in list(self._flowing):
                        self._stop_flow(stream)
        elif is_narrow:
            self._ride_ends_s = max(self._ride_ends_s, now + NARROW_RIDE_S)
        flow, num_flow_bytes = self._flow, self._flow_bytes
        if not flow and not self._line and not voices:
            return None
        self._flow, self._flow_bytes = [], 0
        for frame in flow:
            if frame.layer == 0:
                self._flowing[frame.stream].note_sent(frame.data, frame.is_keyframe)
        if not self._line and not voices:
            if len(flow) == 1:
                return flow[0].alone
            message = media_message([frame.data for frame in flow])
            return OutboundMessage(message, tuple([frame.received_s for frame in flow]))
        frames = [item.frame for item in voices] + [frame.data for frame in flow]
        received_s = [item.received_s for item in voices] + [frame.received_s for frame in flow]
        if self._line:
            for item in self._take_queues(room_left - num_flow_bytes):
                frames.append(item.frame)
                received_s.append(item.received_s)
                num_flow_bytes += len(item.frame)
        if is_narrow and room_left:
            self._saved_bytes = room_left - num_flow_bytes if voices and self._line else 0
        return OutboundMessage(media_message(frames), tuple(received_s)) if frames else None

    def _take_voices(self, room_left: int, now: float) -> list[Waiting]:
        """Take what fits of the ordered streams and is not too old."""
        items: list[Waiting] = []
        for stream in list(self._voices):
            queue = self._ordered[stream]
            queue.expire(now)
            taken = queue.take(room_left)
            room_left -= sum([len(item.frame) for item in taken])
            items += taken
            if not len(queue):
                del self._voices[stream]
        return items

    def _take_queues(self, room_left: int) -> list[Waiting]:
        """Take what fits of the queues; streams whose queue is clear then flow."""
        items: list[Waiting] = []
        for stream in list(self._line):
            queue = self._queues[stream]
            num_bytes = queue.num_bytes
            items += queue.take(room_left)
            if num_bytes > room_left:
                # This message is full. Base frames keep their place, upper ones go to the end.
                if isinstance(queue, StreamQueue) and not queue.has_base:
                    del self._line[stream]
                    self._line[stream] = None
                break
            room_left -= num_bytes
            del self._line[stream]
            if self._may_flow and isinstance(queue, StreamQueue) and queue.is_clear:
                self._flowing[stream] = queue
        return items

    def _stop_flow(self, stream: int) -> StreamQueue | OrderedQueue:
        """Return the queue of a stream with all that waits of it; what comes next goes there."""
        if self._flowing.pop(stream, None) is not None:
            flow, self._flow = self._flow, []
            for frame in flow:
                if frame.stream == stream:
                    # Should a keyframe be needed now, the next frame that is put says so again.
                    self._flow_bytes -= len(frame.data)
                    self._put_queue(frame)
                else:
                    self._flow.append(frame)
        return self._queue(stream)

    def _queue(self, stream: int) -> StreamQueue | OrderedQueue:
        queue = self._queues.get(stream)
        if queue is None:
            queue = self._queues[stream] = StreamQueue(self._drops)
        return queue
