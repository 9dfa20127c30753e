"""Good messages to start from: the golden bytes, and valid sequences of a call, made by chance."""

from __future__ import annotations

import json
import random
from typing import Final

from golden.wire_samples import GOLDEN
from pica_protocol.codec import encode_message
from pica_protocol.frames import Frame, encode_frame, media_message
from pica_protocol.messages import (
    Bye,
    Hello,
    Join,
    Joined,
    Leave,
    Peer,
    PeerAway,
    PeerBack,
    PeerJoined,
    PeerLeft,
    PeerUpdated,
    Report,
    StreamMuted,
    StreamReport,
    Subscribe,
    Track,
    UpdateMetadata,
    Welcome,
    Whisper,
)

GOLDEN_BYTES: Final[dict[str, bytes]] = {
    f"{group} {name}": bytes.fromhex(text)
    for group, vectors in json.loads(GOLDEN.read_text()).items()
    for name, text in vectors.items()
}
"""Every vector of the golden file: valid ones, older ones and invalid ones."""

CORPUS: Final = [data for name, data in GOLDEN_BYTES.items() if not name.startswith("invalid")]
FACE: Final = Track(kind="face")
VOICE: Final = Track(kind="voice", policy="ordered", deadline_ms=100)


def media(rng: random.Random, stream: int, *, num_frames: int = 1, sequence: int = 0) -> bytes:
    """Return a valid media message of one stream."""
    return media_message(
        encode_frame(
            Frame(
                stream=stream,
                sequence=(sequence + i) % 65_536,
                captured_us=33_333 * (sequence + i),
                payload=rng.randbytes(rng.randrange(60)),
            )
        )
        for i in range(num_frames)
    )


def to_relay(rng: random.Random, *, room: str = "lobby", stream: int = 1) -> list[bytes]:
    """Return what a client may send from its first message to its last."""
    sequence = [
        encode_message(Hello(software="fuzz")),
        encode_message(
            Join(
                room=room,
                name="Eve",
                tracks=tuple(rng.choices((FACE, VOICE), k=rng.randrange(5))),
                resumable=rng.random() < 0.5,
            )
        ),
    ]
    others = [
        encode_message(Subscribe(stream=rng.randrange(1, 6), every=rng.choice((0, 1, 2, 4)))),
        encode_message(Whisper(peer_id=f"p{rng.randrange(1, 6)}", data=rng.randbytes(20))),
        encode_message(UpdateMetadata(metadata=(("hand", rng.choice(("up", "down"))),))),
        encode_message(Report(streams=(StreamReport(stream=1, received=9, lost=1),))),
        media(rng, stream),
        media(rng, stream, num_frames=3),
    ]
    sequence += rng.choices(others, k=rng.randrange(8))
    return [*sequence, encode_message(Leave())] if rng.random() < 0.2 else sequence


def to_client(rng: random.Random, tracks: tuple[Track, ...] = (FACE,)) -> list[bytes]:
    """Return what a relay may send to a client that joins with these tracks."""
    own = tuple(
        Track(kind=track.kind, stream=number) for number, track in enumerate(tracks, start=10)
    )
    ada = Peer(peer_id="p1", name="Ada", tracks=(Track(kind="face", stream=1),))
    bob = Peer(peer_id="p3", name="Bob", tracks=(Track(kind="face", stream=3),))
    sequence = [
        encode_message(Welcome()),
        encode_message(Joined(room="lobby", peer_id="p2", tracks=own, peers=(ada,))),
    ]
    others = [
        encode_message(PeerJoined(peer=bob)),
        encode_message(PeerLeft(peer_id=rng.choice(("p1", "p3")), reason="left")),
        encode_message(PeerAway(peer_id=rng.choice(("p1", "p3")))),
        encode_message(PeerBack(peer_id=rng.choice(("p1", "p3")))),
        encode_message(PeerUpdated(peer_id="p1", metadata=(("hand", "up"),))),
        encode_message(StreamMuted(stream=rng.choice((1, 10)), is_muted=rng.random() < 0.5)),
        encode_message(Whisper(peer_id="p1", data=rng.randbytes(68))),
        media(rng, 1),
        media(rng, 3, num_frames=2),
    ]
    sequence += rng.choices(others, k=rng.randrange(8))
    return [*sequence, encode_message(Bye(code=1001))] if rng.random() < 0.2 else sequence


def shuffled(rng: random.Random, sequence: list[bytes]) -> list[bytes]:
    """Return the sequence, now and then with messages exchanged, repeated or left out."""
    sequence = list(sequence)
    for _ in range(rng.choice((0, 0, 0, 1, 2))):
        at, other = rng.randrange(len(sequence)), rng.randrange(len(sequence))
        match rng.randrange(3):
            case 0:
                sequence[at], sequence[other] = sequence[other], sequence[at]
            case 1:
                sequence.insert(at, sequence[other])
            case _ if len(sequence) > 1:
                del sequence[at]
    return sequence
