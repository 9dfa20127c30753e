"""What waits for one reader that is slower than its senders, and what it gets next. Pure.

Every frame stands alone, so little needs to wait: of a stream without a deadline the newest
frame, of an ordered one the last `MAX_WAITING` frames that are within their deadline. So the
memory for a reader is bounded by the number of its streams, and what it reads is fresh.

Deficit round robin (Shreedhar and Varghese 1995) shares what is taken fairly by senders, so that
none can use up the line of a receiver: ordered frames first, and beside them `LATEST_BYTES` of the
others, as a voice must not come late because of faces. Used on both ways: by a publisher for its
own uplink, and by the relay for every receiver that does not keep up.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final

MAX_WAITING: Final = 10
"""Frames of an ordered stream that may wait (chosen: 0.4 s of a voice in packets of 40 ms)."""
QUANTUM_BYTES: Final = 256
"""What each sender may take in one round (chosen: a packet of voice fits)."""
LATEST_BYTES: Final = 160
"""What frames of ``latest`` streams take beside ordered ones (chosen: two sealed faces)."""


@dataclass(eq=False, slots=True)
class QueuedFrame:
    """One encoded frame on its way, as all its readers share it."""

    sender: str
    """Whose it is, for fair shares."""
    stream: int
    data: bytes
    received_s: float
    deadline_s: float | None
    """How long it may wait if it is of an ordered stream; None: it is not."""
    framed: bytes = b""
    """The websocket message that holds it alone, made by the first who sends it."""


@dataclass(eq=False, slots=True)
class _Line:
    """What waits of one sender."""

    frames: deque[QueuedFrame] = field(default_factory=deque)
    credit: int = 0


_Lines = dict[str, _Line]


class FrameQueue:
    """The bounded queue of all frames for one reader."""

    def __init__(self, drops: Counter[str]) -> None:
        """Begin empty.

        Args:
            drops: Where frames that are dropped are counted: ``replaced`` by a newer one of their
                stream, ``overflow`` of an ordered stream, ``expired`` after its deadline.
        """
        self._drops = drops
        # By sender, in the order in which they have their turn.
        self._ordered: _Lines = {}
        self._latest: _Lines = {}
        self._saved_bytes = 0  # what latest frames were left while the next did not fit

    def __len__(self) -> int:
        lines = (*self._ordered.values(), *self._latest.values())
        return sum(len(line.frames) for line in lines)

    @property
    def has_ordered(self) -> bool:
        """Whether a frame of an ordered stream waits."""
        return bool(self._ordered)

    def put(self, frame: QueuedFrame) -> None:
        """Take the next frame of a stream."""
        is_latest = frame.deadline_s is None
        lines = self._latest if is_latest else self._ordered
        frames = lines.setdefault(frame.sender, _Line()).frames
        waiting = [each for each in frames if each.stream == frame.stream]
        if len(waiting) >= (1 if is_latest else MAX_WAITING):
            frames.remove(waiting[0])
            self._drops["replaced" if is_latest else "overflow"] += 1
        frames.append(frame)

    def will_replace(self, stream: int) -> bool:
        """Return True if a frame of this ``latest`` stream waits: the next takes its place."""
        return any(
            frame.stream == stream for line in self._latest.values() for frame in line.frames
        )

    def take(self, max_bytes: int, now: float) -> list[QueuedFrame]:
        """Take the frames that go out next, as many as ``max_bytes`` hold; at least one if any
        waits, whatever its size."""
        if num_expired := self._filter(
            self._ordered, lambda frame: now - frame.received_s <= (frame.deadline_s or 0.0)
        ):
            self._drops["expired"] += num_expired
        ordered = list(_take(self._ordered, max_bytes - LATEST_BYTES, must_take=True))
        room_left = max_bytes - sum(len(frame.data) for frame in ordered)
        if ordered:
            room_left = min(room_left, LATEST_BYTES + self._saved_bytes)
        latest = list(_take(self._latest, room_left, must_take=not ordered))
        unused = room_left - sum(len(frame.data) for frame in latest)
        is_waiting = bool(self._ordered or self._latest)
        self._saved_bytes = min(max(unused, 0), max_bytes) if ordered and is_waiting else 0
        return ordered + latest

    def drop(self, sender: str, stream: int | None = None) -> int:
        """Drop what waits of a sender, or of one of its streams; return how many frames that is."""

        def is_kept(frame: QueuedFrame) -> bool:
            return frame.sender != sender or stream not in (None, frame.stream)

        return self._filter(self._ordered, is_kept) + self._filter(self._latest, is_kept)

    def _filter(self, lines: _Lines, is_kept: Callable[[QueuedFrame], bool]) -> int:
        """Drop all other frames; return how many."""
        before = len(self)
        for name, line in list(lines.items()):
            line.frames = deque(filter(is_kept, line.frames))
            if not line.frames:
                del lines[name]
        return before - len(self)


def _take(lines: _Lines, room_left: int, *, must_take: bool) -> Iterator[QueuedFrame]:
    """Take frames round by round, until none waits or the next does not fit."""
    while lines:
        for name, line in list(lines.items()):
            line.credit += QUANTUM_BYTES
            while line.frames and len(line.frames[0].data) <= line.credit:
                size = len(line.frames[0].data)
                if size > room_left and not must_take:
                    line.credit -= QUANTUM_BYTES
                    return
                must_take = False
                room_left -= size
                line.credit -= size
                yield line.frames.popleft()
            del lines[name]
            if line.frames:
                lines[name] = line
