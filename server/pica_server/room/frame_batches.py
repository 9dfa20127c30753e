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

from collections.abc import Mapping, Set
from typing import Final, NamedTuple

from pica_protocol.frames import media_message

MAX_BUNDLE_FRAMES: Final = 32
MAX_BUNDLE_BYTES: Final = 3584
"""Of one bundle (chosen: four of them fit one message, with a frame to spare)."""
MAX_BUNDLES: Final = 4
"""That may wait for one receiver; one more, and it gets its own queues, which thin."""

_NONE: Final[frozenset[int]] = frozenset()


class OutboundMessage(NamedTuple):
    """One websocket message on its way out."""

    data: bytes
    received_s: tuple[float, ...]
    """When each of its frames came to the relay; empty for a control message."""


class Bundle:
    """Frames that came in one after the other.

    Attributes:
        frames: Stream, frame, layer, whether it is a keyframe, and when it was received.
        num_bytes: Of all frames.
        bases: By stream: the last frame of the base layer and the last keyframe that whoever takes
            this bundle has got, in it or in one before; None where there was no keyframe.
    """

    __slots__ = ("_parcels", "_streams", "bases", "frames", "num_bytes")

    def __init__(self, bases: Mapping[int, tuple[bytes, bytes | None]]) -> None:
        self.frames: list[tuple[int, bytes, int, bool, float]] = []
        self.num_bytes = 0
        self.bases = bases
        self._streams: set[int] = set()
        self._parcels: dict[frozenset[int], OutboundMessage] = {}

    def add(self, stream: int, frame: bytes, layer: int, is_keyframe: bool, now: float) -> None:
        """Take a frame; nobody has taken the bundle yet."""
        self.frames.append((stream, frame, layer, is_keyframe, now))
        self.num_bytes += len(frame)
        self._streams.add(stream)
        if layer == 0:
            _, keyframe = self.bases.get(stream, (b"", None))
            self.bases = {**self.bases, stream: (frame, frame if is_keyframe else keyframe)}

    def carries(self, stream: int) -> bool:
        """Whether a frame of this stream waits here: the next one opens another bundle, so a reader
        that lets `MAX_BUNDLES` wait has as many frames of a stream, and is thinned from there."""
        return stream in self._streams

    @property
    def is_full(self) -> bool:
        """Whether no frame of the largest size fits any more."""
        return len(self.frames) >= MAX_BUNDLE_FRAMES or self.num_bytes > MAX_BUNDLE_BYTES

    def parcel(self, streams: Set[int]) -> OutboundMessage:
        """Return the media message of the frames of some streams.

        This ends the bundle: nothing may be added any more.
        """
        without = self._streams - streams
        found = self._parcels.get(frozenset(without) if without else _NONE)
        if found is None:
            chosen = [item for item in self.frames if item[0] not in without]
            found = self._parcels[frozenset(without)] = OutboundMessage(
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
        self.current = Bundle({})

    def forget_stream(self, stream: int) -> None:
        """Forget a stream that has ended."""
        self.turn_over()
        bases = self.current.bases
        self.current.bases = {key: value for key, value in bases.items() if key != stream}

    def turn_over(self) -> Bundle:
        """End the current bundle, if it has begun; return the one that is current then."""
        if self.current.frames:
            self.current = Bundle(self.current.bases)
        return self.current
