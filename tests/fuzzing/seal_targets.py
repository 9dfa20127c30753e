"""What strangers send to a receiver of an encrypted call: sealed payloads, messages about keys."""

from __future__ import annotations

import random
from typing import Final

from fuzzing.meter import Meter
from fuzzing.mutator import Mutator
from fuzzing.targets import expect
from pica_client.e2ee.errors import OpenError
from pica_client.e2ee.frames import decode_header, derive_key, metadata_of, open_, seal
from pica_client.e2ee.guard import Guard
from pica_client.e2ee.key_messages import KeyMessage, decode, encode, room_key
from pica_client.e2ee.secret import RoomSecret
from pica_protocol.frames import Frame
from pica_protocol.messages import Joined, Peer, PeerJoined, Track, Whisper

_SECRET: Final = RoomSecret(bytes(range(32)))
_WAY: Final = ("p1", "p2")


def sealed_frames(rng: random.Random, meter: Meter) -> None:
    """Sealed payloads: nothing but what was sealed opens."""
    key = derive_key(bytes(16), rng.choice((0, 7, 8, 2**64 - 1)))
    metadata = metadata_of(Frame(stream=1, sequence=2, captured_us=3, payload=b""))
    sealed = [
        seal(rng.randbytes(rng.choice((0, 1, 40, 1100))), metadata, key, counter)
        for counter in (0, 7, 8, 300, 2**64 - 1)
    ]
    mutator = Mutator(rng, sealed)
    for _ in range(50):
        original = rng.choice(sealed)
        data = mutator.mutate_bytes(original)
        try:
            meter.call(decode_header, data)
            meter.call(open_, data, metadata, key)
        except OpenError as error:
            meter.note(f"refused {type(error).__name__}")
            continue
        expect(data in sealed, "a payload opens that nobody sealed:", data)
        meter.note("accepted")


def key_messages(rng: random.Random, meter: Meter) -> None:
    """Messages about keys: nothing but what a member wrote is read."""
    key = room_key(_SECRET, "lobby", b"code")
    told = KeyMessage(True, rng.randbytes(32), bytes(8), bytes(8), 0, 0, 0, bytes(32))
    written = [
        encode(each, key, _WAY, bytes(32), bytes(16))
        for each in (told, told._replace(generation=1))
    ]
    mutator = Mutator(rng, written)
    for _ in range(50):
        data = mutator.mutate_bytes(rng.choice(written))
        if meter.call(decode, data, key, _WAY) is None:
            meter.note("refused")
            continue
        expect(data in written, "a message is read that nobody wrote:", data)
        meter.note("accepted")


def guard(rng: random.Random, meter: Meter) -> None:
    """A guard in a room with one member and one stranger, who sends it anything."""
    ada, bob = (Guard(_SECRET, random_bytes=rng.randbytes) for _ in range(2))
    peers = [
        Peer(peer_id=f"p{number}", name="X", tracks=(Track(kind="face", stream=number),))
        for number in (1, 2, 3)
    ]
    tracks = [peer.tracks for peer in peers]
    for each in (ada, bob):
        each.begin("lobby", "X")
    ada.receive_event(Joined(room="lobby", peer_id="p1", tracks=tracks[0]), 0.0)
    joined = Joined(room="lobby", peer_id="p2", tracks=tracks[1], peers=(peers[0],))
    bob.receive_event(joined, 0.0)
    ada.receive_event(PeerJoined(peer=peers[1]), 0.0)
    for each in (ada, bob):
        each.receive_event(PeerJoined(peer=peers[2]), 0.0)
    now = 0.0
    for _ in range(4):
        for sender, whom, listener in (("p1", "p2", bob), ("p2", "p1", ada)):
            author = ada if listener is bob else bob
            for receiver, data in author.messages_to_send(now):
                if receiver == whom:
                    listener.receive_event(Whisper(peer_id=sender, data=data), now)
    expect("p1" in bob.status.verified, "two who know the secret do not find each other")
    frame = Frame(stream=1, sequence=0, captured_us=0, payload=b"face")
    payload = ada.seal(frame)
    mutator = Mutator(rng, [payload, *(data for _, data in bob.messages_to_send(now))])
    for _ in range(50):
        now += rng.choice((0.0, 0.01, 0.3))
        damaged = mutator.mutate_bytes(payload)
        if rng.random() < 0.5:
            whisper = Whisper(peer_id=rng.choice(("p1", "p3")), data=damaged[:512])
            meter.call(bob.receive_event, whisper, now)
            meter.note("accepted")
        else:
            sent = Frame(
                stream=rng.choice((1, 3, 9)),
                sequence=rng.choice((0, 1)),
                captured_us=0,
                payload=damaged[:1184],
            )
            opened = meter.call(bob.receive_event, sent, now)
            is_good = (sent.stream, sent.sequence, sent.payload) == (1, 0, payload)
            expect(is_good or not opened, "a frame opens that nobody sealed:", sent)
            meter.note("accepted" if opened else "refused OpenError")
        num_messages = len(bob.messages_to_send(now))
        expect(num_messages <= 2, "a stranger makes it talk:", num_messages)
        expect("p3" not in bob.status.verified, "a stranger became a member")
