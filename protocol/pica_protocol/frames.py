"""Media frames: a fixed 8-byte header in front of an opaque payload.

    offset  size  field
    0       2     stream      whose frame this is; unique in the room
    2       2     sequence    numbers the frames of a stream, wraps at 65536
    4       4     upper 21 bits: capture time, in units of 0.1 ms of the sender's clock, wraps after
                  209.7 s; lower 11 bits: bytes of payload that follow the header

All numbers are big-endian. One websocket message is the kind byte 2 and then one or more frames.
The header stays in the clear so that payloads may be encrypted end to end, and the relay forwards a
frame's bytes as they came.

Every frame stands alone: any of them may be dropped. A receiver that wants less of a stream gets
the frames whose sequence number is a multiple of 2 or of 4.
"""

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from pica_protocol import limits
from pica_protocol.errors import RemoteProtocolError

MEDIA_KIND: Final = 2
"""First byte of a websocket message that carries media frames; ``codec.CONTROL_KIND`` is the
other."""
MEDIA_PREFIX: Final = bytes([MEDIA_KIND])
SEQUENCE_MODULUS: Final = 1 << 16
TICK_US: Final = 100
"""Resolution of capture times on the wire, microseconds (chosen: far below a display's frame)."""
LENGTH_BITS: Final = 11
LENGTH_MASK: Final = (1 << LENGTH_BITS) - 1
TICK_MODULUS: Final = 1 << (32 - LENGTH_BITS)

_HEADER = struct.Struct(">HHI")
HEADER_BYTES: Final = _HEADER.size
MAX_PAYLOAD_BYTES: Final = limits.MAX_FRAME_BYTES - HEADER_BYTES
FrameSpan = tuple[int, int, int, int]
_read_header = _HEADER.unpack_from
_MAX_FRAME_BYTES: Final = limits.MAX_FRAME_BYTES
_MAX_MESSAGE_BYTES: Final = limits.MAX_MEDIA_MESSAGE_BYTES


@dataclass(frozen=True, kw_only=True, slots=True)
class Frame:
    """One frame as clients see it."""

    stream: int
    sequence: int
    captured_us: int
    """Sender's clock; from the wire in steps of `TICK_US` and with an origin of its own."""
    payload: bytes

    def __post_init__(self) -> None:
        limits.check_range("frame.stream", self.stream, 1, limits.MAX_STREAM)
        limits.check_range("frame.sequence", self.sequence, 0, SEQUENCE_MODULUS - 1)
        limits.check_range("frame.captured_us", self.captured_us, 0, 2**64 - 1)
        limits.check_range("frame.payload bytes", len(self.payload), 0, MAX_PAYLOAD_BYTES)


def clear_header(frame: Frame) -> bytes:
    """Return the header of a frame without the length of its payload: what a seal covers."""
    ticks = frame.captured_us // TICK_US % TICK_MODULUS
    return _HEADER.pack(frame.stream, frame.sequence, ticks << LENGTH_BITS)


def encode_frame(frame: Frame) -> bytes:
    """Return header and payload, without the kind byte of the message around it."""
    ticks = frame.captured_us // TICK_US % TICK_MODULUS
    word = ticks << LENGTH_BITS | len(frame.payload)
    return _HEADER.pack(frame.stream, frame.sequence, word) + frame.payload


def media_message(encoded_frames: Iterable[bytes]) -> bytes:
    """Join encoded frames into one websocket message; the caller keeps it within the size limit."""
    return MEDIA_PREFIX + b"".join(encoded_frames)


def scan_frames(message: bytes) -> list[FrameSpan]:
    """Check a whole media message and find its frames: stream, sequence, start and end of each.

    Raises:
        RemoteProtocolError: The message is too long or empty, or a frame is cut off, too long, or
            of stream 0.
    """
    # Once for every frame of a relay: written for speed.
    size = len(message)
    if size > _MAX_MESSAGE_BYTES:
        raise RemoteProtocolError(
            f"media message of {size} bytes, the limit is {_MAX_MESSAGE_BYTES}"
        )
    if size < 1 + HEADER_BYTES or message[0] != MEDIA_KIND:
        raise RemoteProtocolError(f"no media frame in a message of {size} bytes")
    spans = []
    start = 1
    while start < size:
        if size - start < HEADER_BYTES:
            raise RemoteProtocolError(f"frame header cut off after {size - start} bytes")
        stream, sequence, word = _read_header(message, start)
        end = start + HEADER_BYTES + (word & LENGTH_MASK)
        if end > size or end - start > _MAX_FRAME_BYTES or not stream:
            raise RemoteProtocolError(
                f"frame of stream {stream} with {word & LENGTH_MASK} bytes of payload, of which "
                f"{size - start - HEADER_BYTES} are there; the limit is {MAX_PAYLOAD_BYTES}"
            )
        spans.append((stream, sequence, start, end))
        start = end
    return spans


def decode_media(
    message: bytes, expected_us: Callable[[int], int] = lambda stream: 0
) -> list[Frame]:
    """Return the frames of one media message, in order; raises as ``scan_frames``.

    Args:
        expected_us: About what a stream's capture time is, microseconds: the wire carries it modulo
            209.7 s, and the time nearest to this is taken.
    """
    frames = []
    for stream, sequence, start, end in scan_frames(message):
        _, _, word = _HEADER.unpack_from(message, start)
        frames.append(
            Frame(
                stream=stream,
                sequence=sequence,
                captured_us=unwrap_time_us(word >> LENGTH_BITS, expected_us(stream)),
                payload=message[start + HEADER_BYTES : end],
            )
        )
    return frames


def unwrap_time_us(ticks: int, near_us: int) -> int:
    """Return the time nearest to ``near_us`` that is ``ticks`` modulo the wrap, never below 0."""
    near = near_us // TICK_US
    half = TICK_MODULUS // 2
    unwrapped = near + (ticks - near + half) % TICK_MODULUS - half
    return (unwrapped if unwrapped >= 0 else ticks) * TICK_US


def sequence_distance(sequence: int, reference: int) -> int:
    """Return how far ``sequence`` is ahead of ``reference``, in -32768..32767, across the wrap."""
    return (sequence - reference + SEQUENCE_MODULUS // 2) % SEQUENCE_MODULUS - SEQUENCE_MODULUS // 2
