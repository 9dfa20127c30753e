"""Media frames: a fixed 16-byte header in front of an opaque payload.

    offset  size  field
    0       2     stream        whose frame this is; unique in the room
    2       2     sequence      counts the frames of a stream, wraps at 65536
    4       1     layer         temporal layer, 0 is the base
    5       1     flags         bit 0: keyframe, decodable alone; the rest is sent as 0, ignored
    6       2     length        bytes of payload that follow the header
    8       8     captured_us   microseconds of the sender's own clock

All numbers are big-endian. One websocket message is the kind byte 2 and then one or more frames.
The header stays in the clear so that payloads may be encrypted end to end, and the relay forwards a
frame's bytes as they came: streams are unique in a room, so not even the stream needs rewriting (it
stands first, alone, in case a gateway between rooms must).
"""

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

from pica_protocol import limits
from pica_protocol.errors import RemoteProtocolError

MEDIA_KIND: Final = 2
"""First byte of a websocket message that carries media frames; ``codec.CONTROL_KIND`` is the
other."""

MEDIA_PREFIX: Final = bytes([MEDIA_KIND])
FLAG_KEYFRAME: Final = 1
SEQUENCE_MODULUS: Final = 1 << 16

_HEADER = struct.Struct(">HHBBHQ")
HEADER_BYTES: Final = _HEADER.size
MAX_PAYLOAD_BYTES: Final = limits.MAX_FRAME_BYTES - HEADER_BYTES


@dataclass(frozen=True, kw_only=True, slots=True)
class Frame:
    """One frame as clients see it."""

    stream: int
    sequence: int
    captured_us: int
    payload: bytes
    layer: int = 0
    is_keyframe: bool = False

    def __post_init__(self) -> None:
        limits.check_range("frame.stream", self.stream, 1, limits.MAX_STREAM)
        limits.check_range("frame.sequence", self.sequence, 0, SEQUENCE_MODULUS - 1)
        limits.check_range("frame.layer", self.layer, 0, limits.MAX_LAYER)
        limits.check_range("frame.captured_us", self.captured_us, 0, 2**64 - 1)
        limits.check_range("frame.payload bytes", len(self.payload), 0, MAX_PAYLOAD_BYTES)


class FrameSpan(NamedTuple):
    """Where one frame lies in a media message, and the little the relay needs to know of it."""

    stream: int
    layer: int
    flags: int
    start: int
    end: int


def encode_frame(frame: Frame) -> bytes:
    """Return header and payload, without the kind byte of the message around it."""
    return (
        _HEADER.pack(
            frame.stream,
            frame.sequence,
            frame.layer,
            FLAG_KEYFRAME if frame.is_keyframe else 0,
            len(frame.payload),
            frame.captured_us,
        )
        + frame.payload
    )


def media_message(encoded_frames: Iterable[bytes]) -> bytes:
    """Join encoded frames into one websocket message; the caller keeps it within the size limit."""
    return MEDIA_PREFIX + b"".join(encoded_frames)


def scan_frames(message: bytes) -> list[FrameSpan]:
    """Check a whole media message and find its frames, without copying anything.

    Raises:
        RemoteProtocolError: The message is too long or empty, or a frame is cut off, too long, of
            stream 0 or of a layer above ``MAX_LAYER``.
    """
    size = len(message)
    if size > limits.MAX_MEDIA_MESSAGE_BYTES:
        raise RemoteProtocolError(
            f"media message of {size} bytes, the limit is {limits.MAX_MEDIA_MESSAGE_BYTES}"
        )
    if size < 1 + HEADER_BYTES or message[0] != MEDIA_KIND:
        raise RemoteProtocolError(f"no media frame in a message of {size} bytes")
    spans = []
    start = 1
    while start < size:
        if size - start < HEADER_BYTES:
            raise RemoteProtocolError(f"frame header cut off after {size - start} bytes")
        stream, _, layer, flags, length, _ = _HEADER.unpack_from(message, start)
        end = start + HEADER_BYTES + length
        if length > MAX_PAYLOAD_BYTES:
            raise RemoteProtocolError(
                f"frame payload of {length} bytes, the limit is {MAX_PAYLOAD_BYTES}"
            )
        if end > size:
            raise RemoteProtocolError(f"frame payload cut off, {end - size} bytes are missing")
        if stream == 0:
            raise RemoteProtocolError("frame of stream 0, which nobody owns")
        if layer > limits.MAX_LAYER:
            raise RemoteProtocolError(f"frame of layer {layer}, the limit is {limits.MAX_LAYER}")
        spans.append(FrameSpan(stream, layer, flags, start, end))
        start = end
    return spans


def decode_media(message: bytes) -> list[Frame]:
    """Return the frames of one media message, in order; raises as ``scan_frames``."""
    frames = []
    for span in scan_frames(message):
        _, sequence, _, _, _, captured_us = _HEADER.unpack_from(message, span.start)
        frames.append(
            Frame(
                stream=span.stream,
                sequence=sequence,
                captured_us=captured_us,
                payload=message[span.start + HEADER_BYTES : span.end],
                layer=span.layer,
                is_keyframe=bool(span.flags & FLAG_KEYFRAME),
            )
        )
    return frames


def sequence_distance(sequence: int, reference: int) -> int:
    """Return how far ``sequence`` is ahead of ``reference``, in -32768..32767, across the wrap."""
    return (sequence - reference + SEQUENCE_MODULUS // 2) % SEQUENCE_MODULUS - SEQUENCE_MODULUS // 2


def unwrap_sequence(sequence: int, near: int) -> int:
    """Return the number nearest to ``near`` that is ``sequence`` modulo 65536.

    A receiver does this once, on arrival, with the newest number of the stream so far; a frame
    from before the first one may become a negative number.
    """
    return near + sequence_distance(sequence, near)
