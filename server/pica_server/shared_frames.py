"""Frames that many receivers of a room get alike: queued once, put together once. Pure.

Most receivers at most times are served alike: they want everything, keep up, and can decode all
that comes. A frame for them is not put into a queue of each but into the room's current bundle, and
each only notes that it is to get the bundle. The first that takes it ends it: what comes later goes
into the next one. The message made of a bundle is the same for all but those who published some of
it, and is made once.

Who is served so, and for which streams, the outbox decides; whenever anything else is asked of a
stream, it first moves the frames of its bundles into its own queues, and from there on all is as
without bundles.
"""

from collections.abc import Set
from typing import Final

from pica_protocol.frames import media_message

MAX_BUNDLE_FRAMES: Final = 32
MAX_BUNDLE_BYTES: Final = 3584
"""Of one bundle (chosen: four of them fit one message, with a frame to spare)."""
MAX_BUNDLES: Final = 4
"""That may wait for one receiver; one more, and it gets its own queues, which thin."""

_NONE: Final[frozenset[int]] = frozenset()


class Bundle:
    """Frames that came in one after the other.

    Attributes:
        frames: Stream, frame, layer, whether it is a keyframe, and when it was received.
        num_bytes: Of all frames.
    """

    __slots__ = ("_bases", "_messages", "_streams", "frames", "num_bytes")

    def __init__(self) -> None:
        self.frames: list[tuple[int, bytes, int, bool, float]] = []
        self.num_bytes = 0
        self._streams: set[int] = set()
        self._bases: list[tuple[int, bytes, bool]] = []
        self._messages: dict[frozenset[int], tuple[bytes, tuple[float, ...]]] = {}

    def add(self, stream: int, frame: bytes, layer: int, is_keyframe: bool, now: float) -> None:
        """Take a frame; nobody has taken the bundle yet."""
        self.frames.append((stream, frame, layer, is_keyframe, now))
        self.num_bytes += len(frame)
        self._streams.add(stream)
        if layer == 0:
            self._bases.append((stream, frame, is_keyframe))

    @property
    def bases(self) -> list[tuple[int, bytes, bool]]:
        """Of each frame of the base layer: stream, frame, and whether it is a keyframe."""
        return self._bases

    def carries(self, stream: int) -> bool:
        """Whether a frame of this stream waits here: the next one opens another bundle, so a reader
        that lets `MAX_BUNDLES` wait has as many frames of a stream, and is thinned from there."""
        return stream in self._streams

    @property
    def is_full(self) -> bool:
        """Whether no frame of the largest size fits any more."""
        return len(self.frames) >= MAX_BUNDLE_FRAMES or self.num_bytes > MAX_BUNDLE_BYTES

    def message(self, streams: Set[int]) -> tuple[bytes, tuple[float, ...]]:
        """Return the media message of the frames of some streams, and when they were received.

        This ends the bundle: nothing may be added any more.
        """
        without = self._streams - streams
        found = self._messages.get(frozenset(without) if without else _NONE)
        if found is None:
            chosen = [item for item in self.frames if item[0] not in without]
            found = self._messages[frozenset(without)] = (
                media_message([item[1] for item in chosen]),
                tuple([item[4] for item in chosen]),
            )
        return found


class SharedFrames:
    """The bundles of one room.

    Attributes:
        current: Where the next frame goes.
    """

    __slots__ = ("current",)

    def __init__(self) -> None:
        self.current = Bundle()

    def turn_over(self) -> Bundle:
        """End the current bundle, if it has begun; return the one that is current then."""
        if self.current.frames:
            self.current = Bundle()
        return self.current
