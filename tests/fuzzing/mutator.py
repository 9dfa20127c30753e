"""Damages messages: blindly, and with knowledge of what they are made of. Seeded, so repeatable.

A third of the damage is done to bytes, as a bad link or a simple fuzzer does it. The rest goes
through the structure: a control message is read, its tree changed and written again by a writer
that may lie (lengths that are not there, repeated keys, extension types, nests a thousand deep); a
media message is written anew from headers that are nearly right.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
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
    *("", " ", ".", "..", "../../etc/passwd", "p1", "p2", "lobby", "face", "latest", "ordered"),
    *("a" * size for size in (16, 17, 63, 64, 65, 120, 121, 128, 129, 2048, 2049, 4096)),
    *("0" * 64, "F" * 64, "0f" * 32, "0f" * 32 + "\n", "ws://a", "wss://[::1]:9/x", "ws://u@h"),
    *("\x00", "\x1b[2J", "\u202e", "\ufeff", "é" * 64, "\U0001f600" * 16, "a\nb", "%s%n{0}"),
    *("type", "stream", "tracks", "hello", "join", "bye", "whisper", "offer"),
)


@dataclass(frozen=True, slots=True)
class Raw:
    """Bytes that the writer puts out as they are."""

    data: bytes


@dataclass(frozen=True, slots=True)
class Pairs:
    """A map as a list of pairs, so that keys may repeat and be anything."""

    items: list[tuple[Any, Any]]


BOMBS: Final = tuple(
    Raw(data)
    for data in (
        b"\x91" * 500,  # lists in lists
        b"\x91" * 15_000,
        b"\x81\xa1a" * 5_000,  # maps in maps
        b"\x81" * 600,  # maps as keys of maps
        b"\xdd\xff\xff\xff\xff",  # a list of four thousand million, which are not there
        b"\xdc\xff\xff" + b"\xc0" * 300,
        b"\xdf\xff\xff\xff\xff" + b"\xa1a\xc0" * 20,
        b"\xde\x00\x11" + b"".join(b"\xa1%c\xc0" % (97 + i) for i in range(17)),
        b"\xdb\xff\xff\xff\xff",
        b"\xda\xff\xffabc",
        b"\xc6\xff\xff\xff\xff",
        b"\xc5\x02\x01" + bytes(513),
        b"\xc9\xff\xff\xff\xff\x01",
        b"\xc7\x04\x01abcd",  # extension types
        b"\xd4\x05x",
        b"\xd6\xff\x00\x00\x00\x00",  # timestamps
        b"\xd7\xff" + b"\xff" * 8,
        b"\xc7\x0c\xff" + b"\xff" * 12,
        b"\xc1",  # never used
        b"\xa3\xff\xfe\xfd",  # no UTF-8
        b"\xa3\xed\xa0\x80",  # half a surrogate pair
        b"\xcb\x7f\xf0" + bytes(6),  # infinity
        b"\xca\x7f\xc0\x00\x00",  # not a number
        b"\xcf" + b"\xff" * 8,
        b"\xd3\x80" + bytes(7),
        (b"\xdc\x00\x40" + b"\xc0" * 64) * 50,
        b"\x9f" * 1500 + b"\xc0" * 3000,
    )
)


def write(value: Any, out: bytearray) -> None:
    """Write a tree as msgpack, with what is wrong in it."""
    match value:
        case Raw(data=data):
            out += data
        case Pairs(items=items):
            out += (
                b"\xdf" + len(items).to_bytes(4) if len(items) > 15 else bytes([128 + len(items)])
            )
            for key, item in items:
                write(key, out)
                write(item, out)
        case list():
            out += (
                b"\xdd" + len(value).to_bytes(4) if len(value) > 15 else bytes([144 + len(value)])
            )
            for item in value:
                write(item, out)
        case str():
            data = value.encode("utf-8", "surrogatepass")
            out += (
                b"\xdb" + len(data).to_bytes(4) + data
                if len(data) > 31
                else (bytes([160 + len(data)]) + data)
            )
        case int() if not -(2**63) <= value < 2**64:
            out += b"\xcf" + b"\xff" * 8
        case _:
            out += msgpack.packb(value)


class Mutator:
    """Makes damaged messages out of good ones."""

    def __init__(self, rng: random.Random, corpus: Sequence[bytes]) -> None:
        """Begin.

        Args:
            rng: The only source of chance.
            corpus: Good messages, to take pieces of.
        """
        self._rng = rng
        self._corpus = corpus
        self._of_bytes: tuple[Callable[[bytearray], bytes | bytearray], ...] = (
            self._flip_bits,
            self._flip_bits,
            self._set_bytes,
            self._truncate,
            self._extend,
            self._splice,
            self._repeat_piece,
            self._remove_piece,
            self._set_integer,
        )

    def mutate(self, data: bytes) -> bytes:
        """Return a damaged message, or now and then the same one."""
        rng = self._rng
        if data and rng.random() < 0.6:
            if data[0] == CONTROL_KIND:
                data = self._through_tree(data)
            elif data[0] == MEDIA_KIND:
                data = self._media(data)
        if rng.random() < 0.5:
            for _ in range(rng.choice((1, 1, 2, 4))):
                data = bytes(rng.choice(self._of_bytes)(bytearray(data)))
        return data[:MAX_BYTES]

    def mutate_bytes(self, data: bytes) -> bytes:
        """Return damaged bytes of a thing that is no message of the wire."""
        for _ in range(self._rng.choice((1, 1, 2, 4))):
            data = bytes(self._rng.choice(self._of_bytes)(bytearray(data)))
        return data[:MAX_BYTES]

    def weird(self) -> Any:
        """Return a value that is probably wrong wherever it is put."""
        rng = self._rng
        match rng.randrange(9):
            case 0 | 1:
                return rng.choice(INTEGERS)
            case 2 | 3:
                return rng.choice(TEXTS)
            case 4:
                return rng.randbytes(rng.choice((0, 1, 16, 64, 511, 512, 513, 2049)))
            case 5:
                return rng.choice((None, True, False, 0.0, -1.5, 1e308, float("nan")))
            case 6:
                return [self.weird() for _ in range(rng.choice((0, 1, 3)))]
            case 7:
                return Pairs([(self.weird(), self.weird()) for _ in range(rng.choice((0, 1, 3)))])
        return rng.choice(BOMBS)

    def _through_tree(self, data: bytes) -> bytes:
        try:
            tree = msgpack.unpackb(data[1:], strict_map_key=False, object_pairs_hook=Pairs)
        except (ValueError, msgpack.UnpackException, RecursionError):
            return data
        tree = Pairs(list(tree.items)) if isinstance(tree, Pairs) else tree
        for _ in range(self._rng.choice((1, 1, 1, 2, 3))):
            tree = self._changed(tree)
        out = bytearray(data[:1])
        write(tree, out)
        return bytes(out)

    def _changed(self, value: Any) -> Any:
        """Change one place of a tree."""
        rng = self._rng
        children = value.items if isinstance(value, Pairs) else value
        if not isinstance(children, list) or not children or rng.random() < 0.15:
            return self.weird() if rng.random() < 0.9 else self._near(value)
        children = list(children)
        at = rng.randrange(len(children))
        is_map = isinstance(value, Pairs)
        match rng.randrange(8):
            case 0:
                del children[at]
            case 1:
                children.insert(rng.randrange(len(children) + 1), children[at])
            case 2:
                children *= rng.choice((2, 5, 17, 65))
            case 3 if is_map:
                children[at] = (self.weird(), children[at][1])
            case 4 if is_map:
                children.append((self.weird(), self.weird()))
            case 5:
                rng.shuffle(children)
            case _ if is_map:
                key, item = children[at]
                children[at] = (key, self._changed(item))
            case _:
                children[at] = self._changed(children[at])
        return Pairs(children[:2000]) if is_map else children[:2000]

    def _near(self, value: Any) -> Any:
        """Return what is nearly the same."""
        if type(value) is int:
            return value + self._rng.choice((-1, 1, 256))
        if isinstance(value, str):
            return value[:-1] if self._rng.random() < 0.5 else value + value[:1]
        return value

    def _media(self, data: bytes) -> bytes:
        """Write a media message anew, with headers that are nearly right."""
        rng = self._rng
        out = bytearray(data[:1])
        for _ in range(rng.choice((0, 1, 1, 2, 5, 60, 900))):
            payload = rng.randbytes(rng.choice((0, 0, 1, 8, 40, 1184, 1185)))
            length = len(payload) if rng.random() < 0.95 else rng.choice((0, 1, 1185, 65_535))
            stream = rng.choice(
                (1, 1, 2, 3, 4, rng.randrange(65_536), 0 if rng.random() < 0.1 else 1)
            )
            sequence, ticks = rng.randrange(65_536), rng.getrandbits(rng.choice((1, 12, 21)))
            out += _HEADER.pack(stream, sequence, ticks << 11 | length & 2047) + payload
            if len(out) > MAX_BYTES:
                break
        return bytes(out)

    def _flip_bits(self, data: bytearray) -> bytearray:
        for _ in range(self._rng.choice((1, 1, 2, 8))):
            if data:
                data[self._rng.randrange(len(data))] ^= 1 << self._rng.randrange(8)
        return data

    def _set_bytes(self, data: bytearray) -> bytearray:
        for _ in range(self._rng.choice((1, 2, 4))):
            if data:
                value = self._rng.choice((0, 1, 2, 0x7F, 0x80, 0xC1, 0xDD, 0xDF, 0xFF))
                data[self._rng.randrange(len(data))] = value
        return data

    def _truncate(self, data: bytearray) -> bytearray:
        return data[: self._rng.randrange(len(data) + 1)]

    def _extend(self, data: bytearray) -> bytearray:
        return data + self._rng.randbytes(self._rng.choice((1, 2, 17, 1000)))

    def _piece(self, data: bytes | bytearray) -> bytes:
        begin = self._rng.randrange(len(data) + 1)
        return bytes(data[begin : begin + self._rng.randrange(64)])

    def _splice(self, data: bytearray) -> bytearray:
        at = self._rng.randrange(len(data) + 1)
        return data[:at] + self._piece(self._rng.choice(self._corpus)) + data[at:]

    def _repeat_piece(self, data: bytearray) -> bytearray:
        at = self._rng.randrange(len(data) + 1)
        return data[:at] + self._piece(data) * self._rng.choice((1, 3, 100)) + data[at:]

    def _remove_piece(self, data: bytearray) -> bytearray:
        at = self._rng.randrange(len(data) + 1)
        return data[:at] + data[at + self._rng.randrange(1, 32) :]

    def _set_integer(self, data: bytearray) -> bytearray:
        size = self._rng.choice((2, 4, 8))
        if len(data) >= size:
            at = self._rng.randrange(len(data) - size + 1)
            value = self._rng.choice(INTEGERS) % 2 ** (8 * size)
            data[at : at + size] = value.to_bytes(size)
        return data
