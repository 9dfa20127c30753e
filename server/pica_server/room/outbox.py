"""What waits for one receiver: every control message, and of each stream what is fresh.

Bounded by design. Frames: one queue for each stream of the room, see
`pica_protocol.stream_queue` and, for ordered streams, `pica_protocol.ordered_queue` for what is
dropped in it and in which order, so a receiver that reads
slowly gets fewer frames, never a stale one for long, and never one it cannot decode. Control: a
queue with a limit in bytes; it is never thinned, a receiver that lets it overflow is closed
instead.

While a receiver keeps up, its frames do not come here one by one: it is given bundles, which it
shares with others, see ``shared_frames``.
"""

import math
from collections import Counter, deque
from collections.abc import Sequence, Set

from pica_protocol.frames import MEDIA_PREFIX, media_message
from pica_protocol.limits import MAX_MEDIA_MESSAGE_BYTES
from pica_protocol.ordered_queue import OrderedQueue
from pica_protocol.stream_queue import Put, StreamQueue, Waiting
from pica_server.errors import OutboxFullError
from pica_server.room.frame_batches import MAX_BUNDLES, Bundle, OutboundMessage, SharedFrames

_WAITS = Put.WAITS


class Outbox:
    """The queue between the room and one receiver's socket.

    Attributes:
        shared: The bundles of the room, or None: every frame is put here.
        flowing: Streams whose frames it takes in bundles: `share` is to be tried before
            `put_frame`.
        newest: The bundle it has taken last, if that still waits.
    """

    def __init__(self, max_control_bytes: int, drops: Counter[str]) -> None:
        """Begin empty.

        Args:
            max_control_bytes: Control messages that may wait.
            drops: Where frames that are dropped for slowness are counted, by reason.
        """
        self._max_control_bytes = max_control_bytes
        self._drops = drops
        self._control: deque[bytes] = deque()
        self._control_bytes = 0
        self._queues: dict[int, StreamQueue | OrderedQueue] = {}
        self._ordered: dict[int, OrderedQueue] = {}
        # Streams with something that waits; dict order is the order of waiting.
        self._line: dict[int, None] = {}
        self.shared: SharedFrames | None = None
        self.flowing: Set[int] = frozenset()
        self.newest: Bundle | None = None
        # While anything flows: the last one that has gone out.
        self._last_taken: Bundle | None = None
        self._bundles: list[Bundle] = []

    @property
    def waiting_frames(self) -> int:
        """How many frames wait, at most a few of each stream."""
        bundled = [item[0] for bundle in self._bundles for item in bundle.frames]
        return sum(map(len, self._queues.values())) + sum(map(self.flowing.__contains__, bundled))

    @property
    def is_waiting(self) -> bool:
        """Whether `take` may have something."""
        return bool(self._bundles or self._line or self._control)

    @property
    def has_control(self) -> bool:
        """Whether a control message waits."""
        return bool(self._control)

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

    def share(self, bundle: Bundle) -> bool:
        """Take a bundle that a frame of a flowing stream is about to come into.

        Returns:
            False if too many wait: nothing flows any more, and the frame is to be put.
        """
        if len(self._bundles) == MAX_BUNDLES:
            self._unbundle()
            return False
        self._bundles.append(bundle)
        self.newest = bundle
        return True

    def put_frame(
        self, stream: int, frame: bytes, layer: int, is_keyframe: bool, now: float
    ) -> Put:
        """Queue a frame, or drop it, and what it replaces; see `StreamQueue.put`."""
        # Once for every frame and receiver: written for speed.
        if stream in self.flowing:
            self._unbundle()
        queue = self._queues.get(stream)
        if queue is None:
            queue = self._queue(stream)
        fate = queue.put(frame, layer, is_keyframe, now)
        if fate is _WAITS:
            self._line[stream] = None  # where it stands already if something of it waited
        return fate

    def open_ordered(self, stream: int, deadline_s: float) -> None:
        """Note that a stream is ordered, if that is news."""
        if stream not in self._ordered:
            self._unbundle()
            self._queues[stream] = self._ordered[stream] = OrderedQueue(self._drops, deadline_s)

    def interrupt(self, stream: int) -> int:
        """Drop what waits of a stream that pauses; return how many frames that is.

        It goes on with a keyframe, or, if it is ordered, with any frame.
        """
        self._unbundle()
        queue = self._queue(stream)
        dropped = queue.want(None)
        if isinstance(queue, OrderedQueue):
            queue.resume((), is_whole=True, now=0.0)
        return dropped

    def want(self, stream: int, layer: int | None) -> int:
        """Follow a wish; return how many waiting frames were dropped for it."""
        self._unbundle()
        return self._queue(stream).want(layer)

    def resume(self, stream: int, chain: Sequence[bytes], *, is_whole: bool, now: float) -> int:
        """Queue what was kept of a stream that the receiver begins to read, or reads again.

        Returns:
            How many frames that is; see `StreamQueue.resume`.
        """
        self._unbundle()
        queue = self._queue(stream)
        queue.resume(chain, is_whole=is_whole, now=now)
        self._line[stream] = None
        return len(queue)

    def forget_stream(self, stream: int) -> int:
        """Forget a stream that has ended; return how many of its frames waited."""
        self._unbundle()
        if self.shared is not None:
            self.shared.forget_stream(stream)
        self._line.pop(stream, None)
        self._ordered.pop(stream, None)
        queue = self._queues.pop(stream, None)
        return 0 if queue is None else len(queue)

    def finish(self, last_words: list[bytes]) -> int:
        """Drop the waiting frames, return how many, and queue the last messages whatever the
        limit."""
        dropped = self.waiting_frames
        self.shared, self.flowing, self.newest, self._bundles = None, frozenset(), None, []
        self._queues.clear()
        self._ordered.clear()
        self._line.clear()
        self._control.extend(last_words)
        self._control_bytes += sum(map(len, last_words))
        return dropped

    def take(self, now: float = -math.inf) -> OutboundMessage | None:
        """Take the next message: control first, then as many frames as one message holds.

        Frames of ordered streams that are too old by ``now`` are dropped.
        """
        if self._control:
            data = self._control.popleft()
            self._control_bytes -= len(data)
            return OutboundMessage(data, ())
        line = self._line
        if self._bundles:
            if not line:
                return self._take_bundles()
            self._unbundle()
        if not line:
            return None
        for ordered in self._ordered.values():
            ordered.expire(now)
        room_left = MAX_MEDIA_MESSAGE_BYTES - 1
        items: list[Waiting] = []
        num_taken = 0
        for stream in line:
            queue = self._queues[stream]
            num_bytes = queue.num_bytes
            items += queue.take(room_left)
            if num_bytes > room_left:
                break  # this message is full; the stream keeps its place
            room_left -= num_bytes
            num_taken += 1
        if num_taken == len(line):
            line.clear()
            self._let_flow()
        else:
            for stream in list(line)[:num_taken]:
                del line[stream]
        if not items:
            return None
        return OutboundMessage(
            media_message([item.frame for item in items]),
            tuple([item.received_s for item in items]),
        )

    def _take_bundles(self) -> OutboundMessage:
        bundles = self._bundles
        newest = self._last_taken = bundles[-1]
        shared = self.shared
        assert shared is not None
        if shared.current is newest:
            shared.turn_over()
        self.newest = None
        if len(bundles) == 1:
            bundles.clear()
            return newest.parcel(self.flowing)
        parcels = [bundle.parcel(self.flowing) for bundle in bundles]
        bundles.clear()
        data = MEDIA_PREFIX + b"".join([parcel.data[len(MEDIA_PREFIX) :] for parcel in parcels])
        return OutboundMessage(
            data, tuple([moment for _, moments in parcels for moment in moments])
        )

    def _unbundle(self) -> None:
        """Put what waits in bundles into the queues, and let these know what has gone out in
        bundles; from now on every frame comes there."""
        flowing, self.flowing = self.flowing, frozenset()
        bundles, self._bundles, self.newest = self._bundles, [], None
        last, self._last_taken = self._last_taken, None
        if last is not None:
            for stream, (frame, keyframe) in last.bases.items():
                queue = self._queues.get(stream)
                if stream in flowing and isinstance(queue, StreamQueue):
                    queue.note_sent(frame, keyframe)
        for bundle in bundles:
            for stream, frame, layer, is_keyframe, received_s in bundle.frames:
                if stream in flowing:
                    # Should a keyframe be needed now, the next frame that is put says so again.
                    self.put_frame(stream, frame, layer, is_keyframe, received_s)

    def _let_flow(self) -> None:
        """Take those streams in bundles from now on that nothing stands in the way of."""
        if self.shared is None:
            return
        self._unbundle()
        self.flowing = {
            stream
            for stream, queue in self._queues.items()
            if isinstance(queue, StreamQueue) and queue.is_clear
        }
        self.shared.turn_over()  # it has got what is in the current one already

    def _queue(self, stream: int) -> StreamQueue | OrderedQueue:
        queue = self._queues.get(stream)
        if queue is None:
            queue = self._queues[stream] = StreamQueue(self._drops)
        return queue
