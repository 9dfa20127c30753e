"""What strangers do to a port: broken HTTP, broken websockets, and good ones with broken messages.

Each function returns what to write, piece by piece; nothing here touches a socket.
"""

from __future__ import annotations

import base64
import random
import struct
from dataclasses import dataclass, field
from typing import Final

from fuzzing.corpus import CORPUS, GOLDEN_BYTES, media, shuffled, to_relay
from fuzzing.mutator import Mutator
from pica_protocol.codec import encode_message
from pica_protocol.messages import Hello

BINARY, TEXT, CONTINUATION, CLOSE, PING, PONG = 2, 1, 0, 8, 9, 10

PATHS: Final = (
    *("/healthz", "/readyz", "/metrics", "/metrics"),
    *("/", "/healthz", "/readyz", "/metrics", "/healthz/", "/HEALTHZ", "/metrics?x=1", "//", "*"),
    *("/avatars", "/avatars/", "/avatars/..", "/avatars/../../etc/passwd", "/avatars/%2e%2e/x"),
    *("/avatars/" + "0f" * 32, "/avatars/" + "0F" * 32, "/avatars/" + "0f" * 32 + "/../x"),
    *("/avatars/" + "0f" * 32 + "\x00.png", "/avatars/" + "a" * 5000, "/avatars/-" + "0" * 63),
    *(
        "http://localhost/healthz",
        "healthz",
        "",
        "/\u00e9",
        "/\x01",
        "/" + "x" * 9000,
        "/api/rooms",
    ),
)
_METHODS: Final = (
    "GET",
    "GET",
    "GET",
    "HEAD",
    "POST",
    "PUT",
    "OPTIONS",
    "get",
    "CONNECT",
    "\x00",
    "",
)
_VERSIONS: Final = ("HTTP/1.1", "HTTP/1.1", "HTTP/1.0", "HTTP/2", "HTTP/9.9", "http/1.1", "")
_HEADERS: Final = (
    "Host: localhost",
    "Host: a\r\nHost: b",
    "Connection: close",
    "Connection: Upgrade, keep-alive",
    "Content-Length: 5",
    "Content-Length: -1",
    "Content-Length: 99999999999999999999",
    "Transfer-Encoding: chunked",
    "Range: bytes=0-",
    "Range: bytes=-99999999999999999999",
    "Range: bytes=\u0663-",
    "If-None-Match: *",
    "Origin: https://evil.example",
    "Origin: null",
    "X-Forwarded-For: 192.0.2.1, 10.0.0.1",
    "X-Forwarded-For: " + ", ".join(["::1"] * 100),
    "Expect: 100-continue",
    "Upgrade: h2c",
    "Sec-WebSocket-Key: short",
    "Sec-WebSocket-Key: " + "A" * 300,
    "Sec-WebSocket-Version: 8",
    "Authorization: Bearer x.y.z",
    "Cookie: " + "c" * 4000,
    " folded: line",
    "no colon at all",
    "Bad\x00Name: x",
    "X: \x7f\x80\xff",
)
_PROTOCOLS: Final = (
    *("pica.1", "pica.1", "pica.1", "pica.1", "pica.1", "pica.store.1", "pica.store.1"),
    *("", "pica.2", "pica.1, pica.store.1", "PICA.1", "chat", "pica.1,,pica.1", "p" * 300),
)


def handshake(rng: random.Random, protocol: str = "pica.1", *, is_good: bool = True) -> bytes:
    """Return the request that opens a websocket, or nearly one."""
    key = base64.b64encode(rng.randbytes(16)).decode()
    lines = [
        "GET / HTTP/1.1",
        "Host: localhost",
        "Upgrade: websocket",
        "Connection: Upgrade",
        f"Sec-WebSocket-Key: {key}",
        "Sec-WebSocket-Version: 13",
    ]
    if protocol:
        lines.append(f"Sec-WebSocket-Protocol: {protocol}")
    if rng.random() < 0.3:
        lines.append("Sec-WebSocket-Extensions: permessage-deflate; client_max_window_bits")
    if not is_good:
        for _ in range(rng.choice((1, 1, 2))):
            match rng.randrange(4):
                case 0:
                    del lines[rng.randrange(len(lines))]
                case 1:
                    lines.insert(rng.randrange(1, len(lines) + 1), rng.choice(_HEADERS))
                case 2:
                    lines.append(rng.choice(lines))
                case _:
                    lines[rng.randrange(len(lines))] = rng.choice(_HEADERS)
    return "\r\n".join([*lines, "", ""]).encode("latin-1", "replace")


def http(rng: random.Random) -> bytes:
    """Return a request that a web server would not like."""
    match rng.randrange(16):
        case 0:
            return rng.randbytes(rng.choice((1, 5, 100, 20_000)))
        case 1:
            return b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + rng.randbytes(200)  # TLS
        case 2:
            return b"GET / HTTP/1.1\r\n" + b"".join(
                b"X-%d: %s\r\n" % (i, b"a" * rng.choice((10, 8000)))
                for i in range(rng.choice((9, 200)))
            )
        case 3:
            return handshake(rng)[: rng.randrange(200)]
        case 4:
            return Mutator(rng, [handshake(rng)]).mutate_bytes(handshake(rng))
        case 5:
            return handshake(rng, rng.choice(_PROTOCOLS), is_good=False)
    # Of four parts one is odd, or two: else nothing gets past the first line.
    odd = rng.choices(range(4), k=rng.choice((0, 1, 1, 2)))
    method = rng.choice(_METHODS) if 0 in odd else "GET"
    version = rng.choice(_VERSIONS) if 1 in odd else "HTTP/1.1"
    headers = rng.choices(_HEADERS, k=rng.randrange(1, 4)) if 2 in odd else ["Host: localhost"]
    end = rng.choice(("\n", "\r", "\0")) if 3 in odd else "\r\n"
    lines = [f"{method} {rng.choice(PATHS)} {version}", *headers, "", ""]
    more = (b"", b"hello", b"GET /healthz HTTP/1.1\r\n\r\n" * 3)
    return end.join(lines).encode("latin-1", "replace") + rng.choice(more)


def frame(
    payload: bytes,
    *,
    opcode: int = BINARY,
    is_final: bool = True,
    reserved: int = 0,
    mask: bytes | None = bytes(4),
    length: int | None = None,
    length_bytes: int = 0,
) -> bytes:
    """Return a websocket frame (RFC 6455 5.2), right or wrong.

    Args:
        payload: What it carries.
        opcode: Its kind.
        is_final: Whether its message ends with it.
        reserved: The three reserved bits; the first is that of compression.
        mask: Four bytes; None leaves it out, as no client may.
        length: What it says, if not the truth.
        length_bytes: 2 or 8 to say so in more bytes than it takes.
    """
    size = len(payload) if length is None else length
    masked = 0x80 if mask is not None else 0
    head = bytes([is_final << 7 | reserved << 4 | opcode])
    if length_bytes == 8 or size > 65_535:
        head += bytes([masked | 127]) + struct.pack(">Q", size)
    elif length_bytes == 2 or size > 125:
        head += bytes([masked | 126]) + struct.pack(">H", size)
    else:
        head += bytes([masked | size])
    if mask is None:
        return head + payload
    if any(mask):
        repeated = (mask * (len(payload) // 4 + 1))[: len(payload)]
        mixed = int.from_bytes(payload) ^ int.from_bytes(repeated)
        payload = mixed.to_bytes(len(payload))
    return head + mask + payload


@dataclass
class Conversation:
    """What is written after the handshake.

    Attributes:
        protocol: Sub-protocol to ask for.
        pieces: What to write, one after the other.
        num_damaged: Damaged messages and pieces of abuse in it.
        num_whole: Good messages.
        is_whole: Whether all frames are whole and right, so that a goodbye can follow.
        codes: Codes of close frames in it, which the relay may send back.
    """

    protocol: str = "pica.1"
    pieces: list[bytes] = field(default_factory=list)
    num_damaged: int = 0
    num_whole: int = 0
    is_whole: bool = True
    codes: set[int] = field(default_factory=set)


def conversation(rng: random.Random) -> Conversation:
    """Return what one connection says."""
    if rng.random() < 0.1:
        return _upload(rng)
    talk = Conversation(protocol=rng.choice(_PROTOCOLS) if rng.random() < 0.05 else "pica.1")
    room = rng.choice(("attic", "cellar", "lobby"))
    messages = shuffled(rng, to_relay(rng, room=room, stream=rng.randrange(1, 5)))
    messages += [media(rng, rng.randrange(1, 5)) for _ in range(rng.choice((0, 4)))]
    mutator = Mutator(rng, CORPUS)
    for message in messages:
        if rng.random() < 0.3:
            message = mutator.mutate(message)
            talk.num_damaged += 1
        else:
            talk.num_whole += 1
        if rng.random() < 0.06:
            _abuse(rng, talk)
        talk.pieces += _framed(rng, message)
    talk.pieces = _cut_anew(rng, talk.pieces)
    return talk


def _upload(rng: random.Random) -> Conversation:
    corpus = [data for name, data in GOLDEN_BYTES.items() if "offer" in name or "chunk" in name]
    corpus.append(encode_message(Hello()))
    mutator = Mutator(rng, corpus)
    talk = Conversation(protocol="pica.store.1")
    for _ in range(rng.choice((1, 2, 3))):
        data = rng.choice(corpus)
        is_damaged = rng.random() < 0.4
        talk.pieces += _framed(rng, mutator.mutate(data) if is_damaged else data)
        talk.num_damaged += is_damaged
        talk.num_whole += not is_damaged
    return talk


def _framed(rng: random.Random, message: bytes) -> list[bytes]:
    """Return the frames of one message: mostly one."""
    mask = rng.choice((bytes(4), rng.randbytes(4)))
    opcode = TEXT if rng.random() < 0.01 else BINARY
    if rng.random() < 0.9:
        return [frame(message, opcode=opcode, mask=mask)]
    cuts = sorted(rng.randrange(len(message) + 1) for _ in range(rng.choice((1, 2, 30))))
    parts = [message[a:b] for a, b in zip([0, *cuts], [*cuts, len(message)], strict=True)]
    return [
        frame(
            part,
            opcode=opcode if i == 0 else CONTINUATION,
            is_final=i == len(parts) - 1,
            mask=mask,
        )
        + (frame(b"?", opcode=PING) if rng.random() < 0.1 else b"")
        for i, part in enumerate(parts)
    ]


def _abuse(rng: random.Random, talk: Conversation) -> None:
    """Add something that a websocket must not contain, or hardly ever does."""
    talk.num_damaged += 1
    match rng.randrange(15):
        case 0:
            talk.pieces.append(frame(b"x" * 10, mask=None))
        case 1:
            talk.pieces.append(frame(b"x" * 10, reserved=rng.randrange(1, 8)))
        case 2:
            talk.pieces.append(frame(b"x", opcode=rng.choice((3, 7, 11, 15))))
        case 3:
            size = rng.choice((126, 1000, 70_000))
            talk.pieces.append(frame(b"x" * size, opcode=rng.choice((PING, PONG, CLOSE))))
        case 4:
            talk.pieces.append(frame(b"x", opcode=PING, is_final=False))
        case 5:
            talk.pieces.append(
                frame(b"", length=rng.choice((16_385, 65_536, 2**31, 2**63 - 1, 2**63)))
            )
        case 6:
            talk.pieces.append(frame(b"x", opcode=CONTINUATION))
        case 7:
            talk.pieces += [frame(b"x", is_final=False), frame(b"y")]
        case 8:
            talk.pieces += [frame(b"\x01", is_final=False)]
            empty = frame(b"", opcode=CONTINUATION, is_final=False)
            talk.pieces += [empty * rng.choice((10, 5000))]
        case 9:
            talk.pieces.append(frame(rng.choice((b"\xff\xfe", b"hello")), opcode=TEXT))
        case 10:
            code = rng.choice((0, 999, 1000, 1004, 1005, 1006, 1016, 2999, 3000, 4000, 4999, 5000))
            payload = rng.choice(
                (b"", b"\x03", code.to_bytes(2) + b"\xff", code.to_bytes(2) + b"x")
            )
            talk.codes |= {code, 1005}
            talk.pieces.append(frame(payload, opcode=CLOSE))
        case 11:
            num = rng.choice((1, 50, 50, 300))
            talk.pieces.append(frame(b"x" * 125, opcode=PING) * num)
            if num <= 50:
                return  # allowed
        case 13:
            message = rng.choice(CORPUS)
            talk.pieces.append(frame(message) * min(2000, 300_000 // len(message)))
        case 12:
            talk.pieces.append(frame(b"\x01\x80", length_bytes=rng.choice((2, 8))))
        case _:
            talk.pieces.append(rng.randbytes(rng.choice((1, 3, 200, 20_000))))
    talk.is_whole = False


def _cut_anew(rng: random.Random, pieces: list[bytes]) -> list[bytes]:
    """Now and then write it in other pieces: all in one, or cut where no frame ends."""
    if rng.random() < 0.7:
        return pieces
    data = b"".join(pieces)
    cuts = sorted(rng.randrange(len(data) + 1) for _ in range(rng.choice((0, 1, 5))))
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]
