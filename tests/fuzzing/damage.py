"""Hypothesis strategies of damaged inputs: of any bytes, and of messages through what they are made
of. A control message is read, some places of its tree change, and it is written again; a media
message is written from headers that are nearly right."""

import json
import struct
from collections.abc import Sequence
from typing import Any, Final

import msgpack
from hypothesis import strategies as st

from helpers.rig_toy import glb_bytes
from pica_protocol.codec import CONTROL_KIND
from pica_protocol.frames import MEDIA_KIND

MAX_BYTES: Final = 20_000
"""Of a damaged input: a little more than a relay reads at once."""
_HEADER = struct.Struct(">HHI")
_NEAR = (0, 1, 7, 16, 63, 64, 127, 128, 255, 1000, 1184, 1200, 3000, 4000, 4999, 65_535, 2**31)
INTEGERS: Final = st.integers(-(2**63), 2**64 - 1) | st.sampled_from(
    [base + offset for base in _NEAR for offset in (-1, 0, 1)]
)
TEXTS: Final = st.text(max_size=20) | st.sampled_from(
    (
        *("", " ", "..", "../../etc/passwd", "p1", "p2", "lobby", "face", "latest", "ordered"),
        *("a" * size for size in (16, 17, 63, 64, 65, 120, 121, 128, 129, 2048, 2049, 4096)),
        *("0" * 64, "F" * 64, "0f" * 32 + "\n", "ws://a", "wss://[::1]:9/x", "ws://u@h"),
        *("\x00", "\x1b[2J", "\u202e", "\ufeff", "\ud800", "é" * 64, "\U0001f600" * 16, "a\nb"),
        *("type", "stream", "tracks", "hello", "join", "bye", "whisper", "offer"),
    )
)
BOMBS: Final = (
    b"\x91" * 15_000,  # lists in lists
    b"\x81\xa1a" * 5_000,  # maps in maps
    b"\x81" * 600,  # maps as keys of maps
    b"\xdd\xff\xff\xff\xff",  # a list of four thousand million, which are not there
    b"\xdf\xff\xff\xff\xff" + b"\xa1a\xc0" * 20,
    b"\xde\x00\x11" + b"".join(b"\xa1%c\xc0" % (97 + i) for i in range(17)),
    b"\x83" + b"\xa4type\xa3bye" * 3,  # repeated keys
    b"\xdb\xff\xff\xff\xff",  # such texts and bytes
    b"\xc6\xff\xff\xff\xff",
    b"\xc9\xff\xff\xff\xff\x01",
    b"\xc7\x04\x01abcd",  # extension types
    b"\xd7\xff" + b"\xff" * 8,  # a time stamp
    b"\xc1",  # never used
    b"\xa3\xff\xfe\xfd",  # no UTF-8
    (b"\xdc\x00\x40" + b"\xc0" * 64) * 50,
)
"""Bytes that are no honest msgpack, or too much of it."""
WEIRD: Final = st.recursive(
    st.none() | st.booleans() | st.floats() | st.binary(max_size=2049) | INTEGERS | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=5,
)
"""Values that are probably wrong wherever they are put."""
PIECES: Final = st.one_of(
    st.binary(max_size=17),
    st.sampled_from(BOMBS),
    st.builds(lambda value, size: (value % 2 ** (8 * size)).to_bytes(size), INTEGERS, st.just(4)),
)


@st.composite
def damaged_bytes(draw: st.DrawFn, good: Sequence[bytes]) -> bytes:
    """Draw one of some inputs, with up to four pieces put in or over it, or cut off behind them."""
    data = draw(st.sampled_from(good))
    for _ in range(draw(st.integers(0, 4))):
        at, other = draw(st.integers(0, len(data))), draw(st.sampled_from(good))
        piece = draw(PIECES | st.just(other[at : at + 64]))
        after = draw(st.sampled_from((at + len(piece), at, at + 31, len(data))))
        data = data[:at] + piece + data[after:]
    return data[: max(MAX_BYTES, *map(len, good))]


@st.composite
def damaged_control(draw: st.DrawFn, good: Sequence[bytes]) -> bytes:
    """Draw one of some control messages with up to three places of its tree changed."""
    data = draw(st.sampled_from(good))
    try:
        tree = msgpack.unpackb(data[1:])
    except (ValueError, msgpack.UnpackException, RecursionError):
        return data
    for _ in range(draw(st.integers(1, 3))):
        tree = _changed(draw, tree)
    packed: bytes = msgpack.packb(tree, unicode_errors="surrogatepass")
    return bytes([CONTROL_KIND]) + packed[:MAX_BYTES]


@st.composite
def damaged_glb(draw: st.DrawFn, document: Any, binary: bytes) -> bytes:
    """Draw a .glb file with up to three places of its document changed."""
    for _ in range(draw(st.integers(1, 3))):
        document = _changed(draw, document)
    return glb_bytes(json.loads(_json(document)), binary)


@st.composite
def damaged_avatar(draw: st.DrawFn, good: bytes) -> bytes:
    """Draw an avatar file with up to three places of its header or its manifest changed."""
    end = 8 + int.from_bytes(good[:8], "little")
    header = json.loads(good[8:end])
    header["__metadata__"] = {k: json.loads(v) for k, v in header["__metadata__"].items()}
    for _ in range(draw(st.integers(1, 3))):
        header = _changed(draw, header)
    if isinstance(header, dict) and isinstance(told := header.get("__metadata__"), dict):
        header["__metadata__"] = {k: _json(v) for k, v in told.items()}
    text = _json(header).encode()
    return len(text).to_bytes(8, "little") + text + good[end:]


def _json(value: Any) -> str:
    """JSON of a tree; bytes and whatever else it cannot hold become texts."""
    return json.dumps(value, default=repr, skipkeys=True)


def _changed(draw: st.DrawFn, value: Any) -> Any:
    """Change one place of a tree."""
    if not isinstance(value, dict | list) or not value or draw(st.integers(0, 7)) == 0:
        return draw(WEIRD)
    children = dict(value) if isinstance(value, dict) else dict(enumerate(value))
    key = draw(st.sampled_from(list(children)))
    match draw(st.integers(0, 4)):
        case 0:
            del children[key]
        case 1:
            children[draw(TEXTS)] = draw(WEIRD)
        case _:
            children[key] = _changed(draw, children[key])
    if isinstance(value, dict):
        return children
    return list(children.values()) * draw(st.sampled_from((1, 1, 1, 5, 65)))


MEDIA: Final = st.lists(
    st.builds(
        lambda stream, sequence, ticks, length, payload: (
            _HEADER.pack(stream, sequence, ticks << 11 | (length or len(payload)) & 2047) + payload
        ),
        st.integers(0, 4) | st.integers(0, 65_535),
        st.integers(0, 65_535),
        st.integers(0, 2**21 - 1),
        st.sampled_from((0, 0, 0, 0, 1, 1185, 2047)),
        st.binary(max_size=40) | st.just(bytes(1184)),
    ),
    max_size=8,
).map(lambda frames: bytes([MEDIA_KIND]) + b"".join(frames))
