"""What of one layered stream waits for one reader, and what is dropped when it reads slowly.

The theory: a slow reader must get fewer but fresh frames, and never a frame it cannot decode. What
a frame refers to follows from its place in the stream alone, so no payload is opened:

    keyframe (layer 0)     refers to nothing
    other frame of layer 0 refers to the frame of layer 0 before it
    frame of layer n       refers to the latest frame before it of a layer below n

So, in this order:

1. A keyframe replaces all that waits. Of a stream of nothing but keyframes the latest waits, alone.
2. Upper layers are dropped first: at most ``MAX_WAITING_UPPER`` frames of them wait; one more drops
   the oldest of the highest layer. What refers to a dropped frame is dropped as it comes.
3. The base layer waits in order. When too much of it waits, in frames, bytes or time, the stream is
   cut for this reader: what waits is dropped, but for a keyframe, and so is all that comes before
   the next keyframe. ``put`` says that one is needed, again with each base frame that it drops.
4. After a subscription to more layers, these start with the next base frame: what came between is
   not known to have reached the reader.
5. After a cut, upper layers stay closed until some base frames have found nothing waiting before
   them; twice as many after each further cut, so that a link with room for the base layer alone
   settles on that.

Used on both ways: by a publisher for its own uplink, and by the relay for every receiver.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, NamedTuple

from pica_protocol.frames import FLAG_KEYFRAME
from pica_protocol.limits import MAX_LAYER

MAX_WAITING_UPPER: Final = 3
"""Upper-layer frames of a stream that may wait: those between two base frames when there are three
dyadic layers (chosen)."""
MAX_WAITING_BASE: Final = 104
"""Base-layer frames that may wait: a chain of ``MAX_CHAIN_FRAMES`` and a second at 7.5 a second."""
MAX_WAITING_BYTES: Final = 6144
"""Bytes of a stream that may wait, headers included; a single frame always may."""
MAX_WAITING_S: Final = 0.5
"""Age of the oldest base frame that waits when the stream is cut (chosen: later than that, a fresh
keyframe comes sooner than the rest of the queue over the link that was too slow for it)."""
MAX_CHAIN_FRAMES: Final = 96
MAX_CHAIN_BYTES: Final = 4096
"""What a relay keeps of a stream for latecomers: a keyframe and the base frames since (chosen: of
some forty bytes with their header, at 7.5 a second, and a keyframe each ten seconds)."""

MIN_PROBATION: Final = 8
MAX_PROBATION: Final = 256
"""Base frames that a reader must take at once after a cut before it gets upper layers again: one
second at 7.5 a second at first, then up to half a minute (chosen)."""

_ALL: Final = MAX_LAYER + 1


class Put(Enum):
    """What became of a frame."""

    WAITS = "waits"
    DROPPED = "dropped"
    BEHIND = "behind"
    """Dropped, and the stream is cut because the reader is too slow: a keyframe is needed."""
    KEYLESS = "keyless"
    """Dropped, because the reader has not got a keyframe yet: one is needed."""


_WAITS: Final = Put.WAITS


class Waiting(NamedTuple):
    """One frame on its way."""

    frame: bytes
    layer: int
    received_s: float


@dataclass(eq=False, slots=True)
class StreamQueue:
    """The bounded queue between one stream and one reader, who has nothing of it yet."""

    _drops: Counter[str]
    """Where frames that are dropped are counted, by reason."""
    _waiting: list[Waiting] = field(default_factory=list)
    _num_base: int = 0
    num_bytes: int = 0
    is_cut: bool = True
    """Whether nothing but a keyframe is let in."""
    _is_behind: bool = False
    _wanted_layer: int = MAX_LAYER
    _open_layer: int = MAX_LAYER
    """The highest layer that has started; goes down at once, up at a base frame."""
    _probation: int = 0
    _penalty: int = MIN_PROBATION
    """Base frames that must pass at once before upper layers start, and as many after a new cut."""
    _blocked_above: int = _ALL
    """Frames above this layer refer to a frame that was dropped."""
    _last_base: bytes = b""
    _last_keyframe: bytes = b""
    """The latest that went out: where the reader stands."""

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def has_base(self) -> bool:
        """Whether a frame of the lowest layer waits."""
        return self._num_base > 0

    @property
    def is_clear(self) -> bool:
        """Whether any frame that comes next would go through, and change nothing: the reader wants
        all layers, has got all that there was, and has not been slow lately."""
        return not (
            self._waiting
            or self.is_cut
            or self._open_layer < MAX_LAYER
            or self._blocked_above < _ALL
            or self._probation
            or self._penalty > MIN_PROBATION
        )

    def note_sent(self, base: bytes, is_keyframe: bool) -> None:
        """Note a base frame that has reached the reader by another way, while this queue was
        clear."""
        self._last_base = base
        if is_keyframe:
            self._last_keyframe = base

    def put(self, frame: bytes, layer: int, is_keyframe: bool, now: float) -> Put:
        """Take the next frame of the stream, header included; all of them must come here in order,
        but for those above the wanted layer."""
        if layer > 0:
            if (
                self._waiting
                or self.is_cut
                or layer > self._open_layer
                or layer > self._blocked_above
            ):
                return self._put_upper(frame, layer, now)
            # Nearly always: nothing in the way. As `_put_upper` would, in a third of the time.
            self._blocked_above = _ALL
            self._waiting.append(Waiting(frame, layer, now))
            self.num_bytes = len(frame)
            return _WAITS
        if self.is_cut and not is_keyframe:
            return self._drop_for_want_of_keyframe()
        self._start_layers()
        if is_keyframe:
            if self._waiting:
                self._drops["replaced"] += len(self._waiting)
            self._waiting = [Waiting(frame, 0, now)]
            self._num_base = 1
            self.num_bytes = len(frame)
            self.is_cut = self._is_behind = False
            return Put.WAITS
        self._append(Waiting(frame, 0, now))
        if len(self._waiting) == 1:
            return Put.WAITS
        self._shed_upper(MAX_WAITING_UPPER)
        if self._is_overfull(now):
            self._cut()
            return Put.BEHIND
        return Put.WAITS

    def want(self, layer: int | None) -> int:
        """Follow a subscription up to ``layer``, or for none; return how many that waited were
        dropped for it. After none, ``resume`` starts again."""
        before = len(self._waiting)
        if layer is None:
            self._replace([])
            self.is_cut = True
        else:
            self._wanted_layer = layer
            self._open_layer = min(self._open_layer, layer)
            self._replace([item for item in self._waiting if item.layer <= layer])
        return before - len(self._waiting)

    def resume(self, chain: Sequence[bytes], *, is_whole: bool, now: float) -> None:
        """Let a reader that has missed something go on with what was kept of the stream.

        Args:
            chain: The latest keyframe and base frames after it, header included.
            is_whole: Whether these are all base frames since; if not, the reader gets the keyframe
                to look at, and what comes then is held back until the next one.
        """
        begin = next((i + 1 for i, frame in enumerate(chain) if frame is self._last_base), 0)
        if not is_whole and chain and chain[0] is self._last_keyframe:
            begin = len(chain)  # it has seen that, and later ones: time must not run backwards
        self._replace([Waiting(frame, 0, now) for frame in chain[begin:]])
        self.is_cut = not is_whole
        self._is_behind = False
        self._open_layer = 0

    def take(self, max_bytes: int) -> list[Waiting]:
        """Take the frames that go out next, in order, as many as ``max_bytes`` hold."""
        taken = self._waiting
        if self.num_bytes <= max_bytes:  # nearly always
            self._waiting = []
            self._num_base = self.num_bytes = 0
        else:
            end = 0
            while (max_bytes := max_bytes - len(taken[end].frame)) >= 0:
                end += 1
            taken = taken[:end]
            self._replace(self._waiting[end:])
        for item in taken:
            if item.layer == 0:
                self._last_base = item.frame
                if item.frame[5] & FLAG_KEYFRAME:
                    self._last_keyframe = item.frame
        return taken

    def _put_upper(self, frame: bytes, layer: int, now: float) -> Put:
        if self.is_cut:
            self._drops["base_cut" if self._is_behind else "before_keyframe"] += 1
            return Put.DROPPED
        if layer > self._open_layer or layer > self._blocked_above:
            self._drops["layer_thinned"] += 1
            # Whatever refers to it must go too; below its layer nothing does.
            self._blocked_above = min(self._blocked_above, layer)
            return Put.DROPPED
        self._blocked_above = _ALL  # above, this is the reference now; below, nothing was blocked
        item = Waiting(frame, layer, now)
        self._append(item)
        if len(self._waiting) == 1:
            return Put.WAITS
        self._shed_upper(MAX_WAITING_UPPER)
        return Put.WAITS if self._waiting and self._waiting[-1] is item else Put.DROPPED

    def _drop_for_want_of_keyframe(self) -> Put:
        if self._is_behind:
            self._drops["base_cut"] += 1
            return Put.BEHIND
        self._drops["before_keyframe"] += 1
        return Put.KEYLESS

    def _start_layers(self) -> None:
        """Note that a base frame goes through: it can be a reference for every layer."""
        if not self._waiting:
            if self._probation:
                self._probation -= 1
            else:
                self._penalty = max(self._penalty - 1, MIN_PROBATION)
        self._open_layer = 0 if self._probation else self._wanted_layer
        self._blocked_above = _ALL

    def _shed_upper(self, max_frames: int) -> None:
        """Drop upper frames until their number and all bytes are within the limits."""
        num_upper = len(self._waiting) - self._num_base
        while num_upper > max_frames or (num_upper and self.num_bytes > MAX_WAITING_BYTES):
            self._drop_highest()
            num_upper -= 1

    def _drop_highest(self) -> None:
        """Drop the oldest waiting frame of the highest layer; nothing that waits refers to it."""
        waiting = self._waiting
        index = max(range(len(waiting)), key=lambda i: (waiting[i].layer, -i))
        dropped = waiting.pop(index)
        self.num_bytes -= len(dropped.frame)
        self._drops["upper_replaced"] += 1
        if index == len(waiting):  # the latest of the stream: what comes next may refer to it
            self._blocked_above = min(self._blocked_above, dropped.layer)

    def _is_overfull(self, now: float) -> bool:
        if self._num_base > MAX_WAITING_BASE or self.num_bytes > MAX_WAITING_BYTES:
            return True
        oldest = next(item for item in self._waiting if item.layer == 0)
        return now - oldest.received_s > MAX_WAITING_S

    def _cut(self) -> None:
        kept = [item for item in self._waiting if item.layer == 0 and item.frame[5] & FLAG_KEYFRAME]
        self._drops["base_cut"] += len(self._waiting) - len(kept)
        self._replace(kept)
        self.is_cut = self._is_behind = True
        self._probation = self._penalty
        self._penalty = min(2 * self._penalty, MAX_PROBATION)

    def _append(self, item: Waiting) -> None:
        self._waiting.append(item)
        self._num_base += item.layer == 0
        self.num_bytes += len(item.frame)

    def _replace(self, waiting: list[Waiting]) -> None:
        self._waiting = waiting
        self._num_base = sum(item.layer == 0 for item in waiting)
        self.num_bytes = sum(len(item.frame) for item in waiting)
