"""What waits for one reader that is slower than its senders, and what it gets next. Pure.

Every frame stands alone, so little needs to wait: of a stream of the policy ``latest`` the newest
frame, of an ``ordered`` one the last `MAX_WAITING` frames that are within their deadline. So the
memory for a reader is bounded by the number of its streams, and what it reads is fresh.

What is taken is shared fairly by senders, so that no sender can use up the line of a receiver:
ordered frames first, by deficit round robin (Shreedhar and Varghese 1995), and beside them
`LATEST_BYTES` of the others in turn, as a voice must not come late because of faces. Used on both
ways: by a publisher for its own uplink, and by the relay for every receiver that does not keep up.
"""

from collections import Counter, deque
from collections.abc import Iterator
from typing import Final

MAX_WAITING: Final = 10
"""Frames of an ordered stream that may wait (chosen: 0.4 s of a voice in packets of 40 ms)."""
QUANTUM_BYTES: Final = 256
"""What each sender may take of ordered frames in one round (chosen: a packet of voice fits)."""
LATEST_BYTES: Final = 160
"""What frames of ``latest`` streams take beside ordered ones (chosen: two sealed faces)."""


class QueuedFrame:
    """One encoded frame on its way, as all its readers share it.

    Attributes:
        sender: Whose it is, for fair shares.
        deadline_s: How long it may wait if it is of an ordered stream; None: it is not.
        framed: The websocket message that holds it alone, made by the first who sends it.
    """

    __slots__ = ("data", "deadline_s", "framed", "received_s", "sender", "stream")

    def __init__(
        self, sender: str, stream: int, data: bytes, received_s: float, deadline_s: float | None
    ) -> None:
        self.sender = sender
        self.stream = stream
        self.data = data
        self.received_s = received_s
        self.deadline_s = deadline_s
        self.framed = b""


class _Sender:
    __slots__ = ("credit", "latest", "ordered")

    def __init__(self) -> None:
        self.latest: dict[int, QueuedFrame] = {}
        self.ordered: deque[QueuedFrame] = deque()
        self.credit = 0


class FrameQueue:
    """The bounded queue of all frames for one reader."""

    def __init__(self, drops: Counter[str]) -> None:
        """Begin empty.

        Args:
            drops: Where frames that are dropped are counted: ``replaced`` by a newer one of their
                stream, ``overflow`` of an ordered stream, ``expired`` after its deadline.
        """
        self._drops = drops
        # In the order in which they were served: who was served last stands last.
        self._senders: dict[str, _Sender] = {}
        self._saved_bytes = 0  # what latest frames were left while the next did not fit

    def __len__(self) -> int:
        return sum(len(each.latest) + len(each.ordered) for each in self._senders.values())

    @property
    def has_ordered(self) -> bool:
        """Whether a frame of an ordered stream waits."""
        return any(sender.ordered for sender in self._senders.values())

    def put(self, frame: QueuedFrame) -> None:
        """Take the next frame of a stream."""
        sender = self._senders.get(frame.sender)
        if sender is None:
            sender = self._senders[frame.sender] = _Sender()
        if frame.deadline_s is None:
            if sender.latest.pop(frame.stream, None) is not None:
                self._drops["replaced"] += 1
            sender.latest[frame.stream] = frame
            return
        sender.ordered.append(frame)
        if sum(each.stream == frame.stream for each in sender.ordered) > MAX_WAITING:
            oldest = next(each for each in sender.ordered if each.stream == frame.stream)
            sender.ordered.remove(oldest)
            self._drops["overflow"] += 1

    def take(self, max_bytes: int, now: float) -> list[QueuedFrame]:
        """Take the frames that go out next, as many as ``max_bytes`` hold; at least one if any
        waits, whatever its size."""
        self._expire(now)
        ordered = list(self._take_ordered(max_bytes - LATEST_BYTES))
        room_left = max_bytes - sum(len(frame.data) for frame in ordered)
        if ordered:
            room_left = min(room_left, LATEST_BYTES + self._saved_bytes)
        latest = list(self._take_latest(room_left, must_take=not ordered))
        is_waiting = bool(self._senders)
        unused = room_left - sum(len(frame.data) for frame in latest)
        self._saved_bytes = min(max(unused, 0), max_bytes) if ordered and is_waiting else 0
        return ordered + latest

    def drop(self, stream: int) -> int:
        """Drop what waits of a stream; return how many frames that is."""
        before = len(self)
        for name, sender in list(self._senders.items()):
            sender.latest.pop(stream, None)
            sender.ordered = deque(frame for frame in sender.ordered if frame.stream != stream)
            self._forget_if_empty(name, sender)
        return before - len(self)

    def _expire(self, now: float) -> None:
        for name, sender in list(self._senders.items()):
            kept = [f for f in sender.ordered if now - f.received_s <= (f.deadline_s or 0.0)]
            if len(kept) < len(sender.ordered):
                self._drops["expired"] += len(sender.ordered) - len(kept)
                sender.ordered = deque(kept)
                self._forget_if_empty(name, sender)

    def _take_ordered(self, room_left: int) -> Iterator[QueuedFrame]:
        """Take ordered frames round by round, until none waits or the next does not fit."""
        talking = [(name, each) for name, each in self._senders.items() if each.ordered]
        is_first = True
        while talking:
            name, sender = talking.pop(0)
            sender.credit += QUANTUM_BYTES
            while sender.ordered and len(sender.ordered[0].data) <= sender.credit:
                size = len(sender.ordered[0].data)
                if size > room_left and not is_first:
                    sender.credit -= QUANTUM_BYTES
                    return
                is_first = False
                room_left -= size
                sender.credit -= size
                self._serve(name, sender)
                yield sender.ordered.popleft()
            if sender.ordered:
                talking.append((name, sender))
            else:
                sender.credit = 0
                self._forget_if_empty(name, sender)

    def _take_latest(self, room_left: int, *, must_take: bool) -> Iterator[QueuedFrame]:
        """Take latest frames of one sender after the other, those served longest ago first."""
        for name, sender in list(self._senders.items()):
            for stream, frame in list(sender.latest.items()):
                if len(frame.data) > room_left and not must_take:
                    return
                must_take = False
                room_left -= len(frame.data)
                del sender.latest[stream]
                self._serve(name, sender)
                yield frame
            self._forget_if_empty(name, sender)

    def _serve(self, name: str, sender: _Sender) -> None:
        del self._senders[name]
        self._senders[name] = sender

    def _forget_if_empty(self, name: str, sender: _Sender) -> None:
        if not (sender.latest or sender.ordered):
            del self._senders[name]
