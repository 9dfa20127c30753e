"""One sample of everything that travels; the golden bytes in ``wire.json`` are made of these.

``python tests/golden/wire_samples.py`` writes the file anew.
"""

import json
from dataclasses import replace
from pathlib import Path

from pica_protocol.codec import encode_chunk, encode_message
from pica_protocol.frames import Frame, encode_frame, media_message
from pica_protocol.messages import (
    BarIdentity,
    Bye,
    Join,
    Joined,
    Leave,
    Message,
    MutePeer,
    Offer,
    Peer,
    PeerAway,
    PeerBack,
    PeerJoined,
    PeerLeft,
    PeerUpdated,
    Ready,
    RemovePeer,
    Stored,
    StoreMessage,
    StreamMuted,
    Subscribe,
    Track,
    UpdateMetadata,
    Whisper,
)

GOLDEN = Path(__file__).with_name("wire.json")

_AVATAR = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
_ADA = Peer(
    peer_id="p1",
    name="Ada",
    tracks=(Track(kind="face", avatar=_AVATAR, stream=1),),
    metadata=(("role", "host"),),
)
_KNOWN_ADA = replace(_ADA, identity="ada-1", is_name_assured=True)

MESSAGES: dict[str, Message] = {
    "join": Join(
        room="lobby",
        name="Bob",
        tracks=(Track(kind="face"),),
        token="h.c.s",
        metadata=(("seat", "2"),),
        resumable=True,
    ),
    "join again": Join(room="lobby", name="Bob", resumable=True, resume="x9Jd0cW1bQe7"),
    "join with voice": Join(
        room="lobby", name="Bob", tracks=(Track(kind="voice", policy="ordered", deadline_ms=200),)
    ),
    "joined": Joined(
        room="lobby",
        peer_id="p2",
        tracks=(Track(kind="face", stream=2),),
        peers=(_ADA,),
        resumed=True,
        resume="Zk3vT8mN5rLa",
    ),
    "joined with a name": Joined(
        room="lobby", peer_id="p2", peers=(replace(_KNOWN_ADA, tracks=()),), name="Bob"
    ),
    "peer_joined": PeerJoined(peer=_ADA),
    "peer_joined with identity": PeerJoined(peer=replace(_KNOWN_ADA, tracks=())),
    "peer_left": PeerLeft(peer_id="p1", reason="lost"),
    "peer_away": PeerAway(peer_id="p1"),
    "peer_back": PeerBack(peer_id="p1"),
    "peer_updated": PeerUpdated(peer_id="p1", metadata=(("role", "host"), ("hand", "up"))),
    "stream_muted": StreamMuted(stream=1, is_muted=True),
    "update_metadata": UpdateMetadata(metadata=(("role", "host"), ("hand", "up"))),
    "leave": Leave(),
    "subscribe": Subscribe(stream=1, every=4),
    "subscribe to nothing": Subscribe(stream=1, every=0),
    "whisper": Whisper(peer_id="p1", data=b"for your eyes only"),
    "remove_peer": RemovePeer(peer_id="p1"),
    "mute_peer": MutePeer(peer_id="p1", kind="voice", is_muted=True),
    "bar_identity": BarIdentity(identity="ada-1", is_barred=True),
    "bye": Bye(code=4004, reason="room lobby is full: 16 peers"),
    "bye elsewhere": Bye(code=1001, reason="the relay is stopping", url="wss://b.example.org"),
}

FRAMES: dict[str, list[Frame]] = {
    "one frame": [
        Frame(
            stream=1,
            sequence=65_535,
            captured_us=123_456_700,
            payload=b"opaque",
        )
    ],
    "two frames": [
        Frame(stream=1, sequence=0, captured_us=33_300, payload=b"face"),
        Frame(stream=2, sequence=7, captured_us=0, payload=b""),
    ],
    "voice packet": [Frame(stream=3, sequence=7, captured_us=34_560_000, payload=b"opus packet")],
}


STORE_MESSAGES: dict[str, StoreMessage] = {
    "offer": Offer(sha256=_AVATAR, size=4, token="h.c.s"),
    "ready": Ready(),
    "stored": Stored(is_new=True),
}
"""Samples of the sub-protocol ``pica.store.1``."""
CHUNK = b"test"


def store_bytes() -> dict[str, bytes]:
    """Return the websocket message of every sample of ``pica.store.1``."""
    messages = {name: encode_message(message) for name, message in STORE_MESSAGES.items()}
    return messages | {"chunk": encode_chunk(CHUNK)}


def wire_bytes() -> dict[str, bytes]:
    """Return the websocket message of every sample."""
    messages = {name: encode_message(message) for name, message in MESSAGES.items()}
    media = {name: media_message(map(encode_frame, frames)) for name, frames in FRAMES.items()}
    return messages | media


def invalid_bytes() -> dict[str, bytes]:
    """Return one broken sibling of each kind that a decoder must refuse."""
    subscribe, frame = wire_bytes()["subscribe"], wire_bytes()["one frame"]
    return {
        "nothing at all": b"",
        "unknown kind of message": b"\x03" + subscribe[1:],
        "control without a map": b"\x01\x90",
        "control cut off": subscribe[:-1],
        "control with bytes to spare": subscribe + b"\x00",
        "unknown type": subscribe.replace(b"subscribe", b"subscrybe"),
        "required field missing": b"\x01\x81\xa4type\xa9subscribe",
        "number where text belongs": encode_message(Bye(code=1000, reason="x")).replace(
            b"\xa1x", b"\x07"
        ),
        "whisper above the limit": b"\x01\x83\xa4type\xa7whisper\xa7peer_id\xa2p1\xa4data"
        + b"\xc5\x02\x01"
        + bytes(513),
        "token above the limit": b"\x01\x84\xa4type\xa4join\xa4room\xa1r\xa4name\xa1n\xa5token"
        + b"\xda\x08\x01"
        + b"x" * 2049,
        "bytes where text belongs": b"\x01\x82\xa4type\xa9peer_left\xa7peer_id\xc4\x02p1",
        "text where bytes belong": encode_message(Whisper(peer_id="p1", data=b"x")).replace(
            b"\xc4\x01x", b"\xa1x"
        ),
        "metadata above the limit": encode_message(
            UpdateMetadata(metadata=(("k", "x" * 64),))
        ).replace(b"\xd9\x40x", b"\xd9\x41xx"),
        "number where true or false belongs": encode_message(
            StreamMuted(stream=1, is_muted=True)
        ).replace(b"\xc3", b"\x01"),
        "deadline of a latest track": encode_message(
            Join(room="r", name="n", tracks=(Track(kind="face"),))
        ).replace(b"deadline_ms\x00", b"deadline_ms\x01"),
        "stream 0": encode_message(Subscribe(stream=1)).replace(b"stream\x01", b"stream\x00"),
        "key that stands twice": subscribe[:1] + b"\x84" + subscribe[2:] + b"\xa5every\x04",
        "name that draws nothing": encode_message(Join(room="r", name="n")).replace(
            b"\xa1n", b"\xa3\xe3\x85\xa4"
        ),
        "map with a number as key": b"\x01\x81\x01\x01",
        "extension type": b"\x01\xd4\x05\x00",
        "media without a frame": b"\x02",
        "header cut off": frame[:8],
        "payload cut off": frame[:-1],
        "byte behind the last frame": frame + b"\x00",
        "frame of stream 0": frame[:1] + b"\x00\x00" + frame[3:],
        "share of a third": encode_message(Subscribe(stream=1, every=4)).replace(
            b"every\x04", b"every\x03"
        ),
        "payload above the limit": frame[:7] + b"\xff\xff" + frame[9:],
    }


def _write() -> None:
    golden = {
        "valid": {name: data.hex() for name, data in wire_bytes().items()},
        "invalid": {name: data.hex() for name, data in invalid_bytes().items()},
        "store": {name: data.hex() for name, data in store_bytes().items()},
    }
    GOLDEN.write_text(json.dumps(golden, indent=2) + "\n")


if __name__ == "__main__":
    _write()
