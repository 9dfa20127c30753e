"""One sample of everything that travels; the golden bytes in ``wire.json`` are made of these.

``python tests/golden/wire_samples.py`` writes the file again, but for what a decoder must refuse,
which stands in it alone.
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
    Message,
    MutePeer,
    Offer,
    Peer,
    PeerAway,
    PeerJoined,
    PeerLeft,
    PeerUpdated,
    Ready,
    RemovePeer,
    Stored,
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
        room="lobby", name="Bob", tracks=(Track(kind="voice", deadline_ms=200),)
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
    "peer_away": PeerAway(peer_id="p1", is_away=True),
    "peer_back": PeerAway(peer_id="p1", is_away=False),
    "peer_updated": PeerUpdated(peer_id="p1", metadata=(("role", "host"), ("hand", "up"))),
    "stream_muted": StreamMuted(stream=1, is_muted=True),
    "update_metadata": UpdateMetadata(metadata=(("role", "host"), ("hand", "up"))),
    "subscribe": Subscribe(stream=1, every=4),
    "subscribe to nothing": Subscribe(stream=1, every=0),
    "whisper": Whisper(peer_id="p1", data=b"for your eyes only"),
    "remove_peer": RemovePeer(peer_id="p1"),
    "mute_peer": MutePeer(peer_id="p1", kind="voice", is_muted=True),
    "bar_identity": BarIdentity(identity="ada-1", is_barred=True),
    "bye": Bye(code=4004, reason="room lobby is full: 16 peers"),
    "bye elsewhere": Bye(code=1001, reason="the relay is stopping", url="wss://b.example.org"),
    "offer": Offer(sha256=_AVATAR, size=4, token="h.c.s"),
    "ready": Ready(),
    "stored": Stored(is_new=True),
}

FRAMES: dict[str, list[Frame]] = {
    "one frame": [Frame(stream=1, sequence=65_535, captured_us=123_456_700, payload=b"opaque")],
    "two frames": [
        Frame(stream=1, sequence=0, captured_us=33_300, payload=b"face"),
        Frame(stream=2, sequence=7, captured_us=0, payload=b""),
    ],
    "voice packet": [Frame(stream=3, sequence=7, captured_us=34_560_000, payload=b"opus packet")],
}
CHUNK = b"test"


def wire_bytes() -> dict[str, bytes]:
    """Return the websocket message of every sample."""
    messages = {name: encode_message(message) for name, message in MESSAGES.items()}
    media = {name: media_message(map(encode_frame, frames)) for name, frames in FRAMES.items()}
    return messages | media


def _write() -> None:
    golden = {
        "valid": {name: data.hex() for name, data in wire_bytes().items()},
        "invalid": json.loads(GOLDEN.read_text())["invalid"],
        "store": {"chunk": encode_chunk(CHUNK).hex()},
    }
    GOLDEN.write_text(json.dumps(golden, indent=2) + "\n")


if __name__ == "__main__":
    _write()
