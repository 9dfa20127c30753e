"""Damages messages: blindly, and with knowledge of what they are made of. Seeded, so repeatable.

A part of the damage is done to bytes, as a bad link or a simple fuzzer does it. The rest goes
through the structure: a control message is read, its tree changed and written again by a writer
that may lie (lengths that are not there, repeated keys, extension types, nests a thousand deep); a
media message is written anew from headers that are nearly right.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Sequence
from typing import Any, Final

import msgpack

from pica_protocol.codec import CONTROL_KIND
from pica_protocol.frames import MEDIA_KIND

MAX_BYTES: Final = 20_000
"""Of a damaged message: a little more than a relay reads at once."""
_HEADER = struct.Struct(">HHI")

_NEAR = (0, 1, 7, 16, 63, 64, 127, 128, 255, 1000, 1184, 1200, 3000, 4000, 4999, 65_535)
INTEGERS: Final = (
    *(base + offset for base in _NEAR for offset in (-1, 0, 1)),
    *(-(2**63), -(2**31), 2**31, 2**32, 2**62, 2**63 - 1, 2**63, 2**64 - 1),
)
TEXTS: Final = (
    *("", " ", "..", "../../etc/passwd", "p1", "p2", "lobby", "face", "latest", "ordered"),
    *("a" * size for size in (16, 17, 63, 64, 65, 120, 121, 128, 129, 2048, 2049, 4096)),
    *("0" * 64, "F" * 64, "0f" * 32, "0f" * 32 + "\n", "ws://a", "wss://[::1]:9/x", "ws://u@h"),
    *("\x00", "\x1b[2J", "\u202e", "\ufeff", "é" * 64, "\U0001f600" * 16, "a\nb", "%s%n{0}"),
    *("type", "stream", "tracks", "hello", "join", "bye", "whisper", "offer"),
)
OTHERS: Final = (None, True, False, 0.0, -1.5, 1e308, float("nan"), b"", bytes(512), bytes(2049))
BOMBS: Final = (
    b"\x91" * 15_000,  # lists in lists
    b"\x81\xa1a" * 5_000,  # maps in maps
    b"\x81" * 600,  # maps as keys of maps
    b"\xdd\xff\xff\xff\xff",  # a list of four thousand million, which are not there
    b"\xdf\xff\xff\xff\xff" + b"\xa1a\xc0" * 20,
    b"\xde\x00\x11" + b"".join(b"\xa1%c\xc0" % (97 + i) for i in range(17)),
    b"\xdb\xff\xff\xff\xff",  # such texts and bytes
    b"\xc6\xff\xff\xff\xff",
    b"\xc9\xff\xff\xff\xff\x01",
    b"\xc7\x04\x01abcd",  # extension types
    b"\xd7\xff" + b"\xff" * 8,  # a time stamp
    b"\xc1",  # never used
    b"\xa3\xff\xfe\xfd",  # no UTF-8
    b"\xa3\xed\xa0\x80",  # half a surrogate pair
    (b"\xdc\x00\x40" + b"\xc0" * 64) * 50,
)
"""Bytes that are no honest msgpack, or too much of it."""


class _Map(list[tuple[Any, Any]]):
    """A map as a list of pairs, so that keys may repeat and be anything."""


class _Raw(bytes):
    """Bytes that are written as they are."""


def _write(value: Any) -> bytes:
    """A tree as msgpack, with what is wrong in it."""
    match value:
        case _Raw():
            return bytes(value)
        case _Map():
            pairs = b"".join(_write(key) + _write(item) for key, item in value)
            return b"\xdf" + len(value).to_bytes(4) + pairs
        case list():
            return b"\xdd" + len(value).to_bytes(4) + b"".join(map(_write, value))
        case int() if not -(2**63) <= value < 2**64:
            return b"\xcf" + b"\xff" * 8
    packed: bytes = msgpack.packb(value, unicode_errors="surrogatepass")
    return packed


class Mutator:
    """Makes damaged messages out of good ones.

    Args:
        rng: The only source of chance.
        corpus: Good messages, to take pieces of.
    """

    def __init__(self, rng: random.Random, corpus: Sequence[bytes]) -> None:
        self._rng, self._corpus = rng, corpus

    def mutate(self, data: bytes) -> bytes:
        """Return a damaged message, or now and then the same one."""
        if data and self._rng.random() < 0.6:
            if data[0] == CONTROL_KIND:
                data = self._through_tree(data)
            elif data[0] == MEDIA_KIND:
                data = self._media(data)
        return self.mutate_bytes(data) if self._rng.random() < 0.5 else data[:MAX_BYTES]

    def mutate_bytes(self, data: bytes) -> bytes:
        """Return damaged bytes of a thing that is no message of the wire."""
        rng = self._rng
        for _ in range(rng.choice((1, 1, 2, 4))):
            at, other = rng.randrange(len(data) + 1), rng.choice(self._corpus)
            begin = rng.randrange(len(other) + 1)
            size = rng.choice((2, 4, 8))
            integer = (rng.choice(INTEGERS) % 2 ** (8 * size)).to_bytes(size)
            piece = rng.choice(
                (
                    bytes([data[at] ^ 1 << rng.randrange(8)]) if at < len(data) else b"\xff",
                    bytes([rng.choice((0, 1, 0x7F, 0x80, 0xC1, 0xDD, 0xDF, 0xFF))]),
                    integer,
                    rng.randbytes(rng.choice((1, 2, 17, 1000))),
                    other[begin : begin + rng.randrange(64)],
                    data[at : at + rng.randrange(64)] * rng.choice((1, 3, 100)),
                    b"",
                )
            )
            # In the place of as much, in the place of other bytes, or as the end.
            after = rng.choice((at + len(piece), at + len(piece), at, at + 31, len(data)))
            data = data[:at] + piece + data[after:]
        return data[:MAX_BYTES]

    def weird(self) -> Any:
        """Return a value that is probably wrong wherever it is put."""
        rng = self._rng
        match rng.randrange(7):
            case 0 | 1:
                return rng.choice(INTEGERS)
            case 2 | 3:
                return rng.choice(TEXTS)
            case 4:
                return rng.choice(OTHERS)
            case 5:
                return rng.choice((list, _Map))(
                    (self.weird(), self.weird()) for _ in range(rng.choice((0, 1, 3)))
                )
        return _Raw(rng.choice(BOMBS))

    def _through_tree(self, data: bytes) -> bytes:
        try:
            tree = msgpack.unpackb(data[1:], strict_map_key=False, object_pairs_hook=_Map)
        except (ValueError, msgpack.UnpackException, RecursionError):
            return data
        for _ in range(self._rng.choice((1, 1, 1, 2, 3))):
            tree = self._changed(tree)
        return data[:1] + _write(tree)

    def _changed(self, value: Any) -> Any:
        """Change one place of a tree."""
        rng = self._rng
        if not isinstance(value, list) or not value or rng.random() < 0.15:
            if type(value) is int and rng.random() < 0.2:
                return value + rng.choice((-1, 1, 256))
            return value[:-1] if isinstance(value, str) and rng.random() < 0.1 else self.weird()
        is_map, children = isinstance(value, _Map), type(value)(value)
        at = rng.randrange(len(children))
        match rng.randrange(8):
            case 0:
                del children[at]
            case 1:
                children.insert(rng.randrange(len(children) + 1), children[at])
            case 2:
                children *= rng.choice((2, 5, 17, 65))
            case 3 if is_map:
                children[at] = (self.weird(), children[at][1])
            case 4:
                children.append((self.weird(), self.weird()))
            case _ if is_map:
                children[at] = (children[at][0], self._changed(children[at][1]))
            case _:
                children[at] = self._changed(children[at])
        return type(value)(children[:2000])

    def _media(self, data: bytes) -> bytes:
        """Write a media message anew, with headers that are nearly right."""
        rng = self._rng
        out = bytearray(data[:1])
        for _ in range(rng.choice((0, 1, 1, 2, 5, 60, 900))):
            payload = rng.randbytes(rng.choice((0, 0, 1, 8, 40, 1184, 1185)))
            length = len(payload) if rng.random() < 0.95 else rng.choice((0, 1, 1185, 65_535))
            stream = rng.choice((0, 1, 1, 1, 2, 3, 4, rng.randrange(65_536)))
            sequence, ticks = rng.randrange(65_536), rng.getrandbits(rng.choice((1, 12, 21)))
            out += _HEADER.pack(stream, sequence, ticks << 11 | length & 2047) + payload
        return bytes(out)
