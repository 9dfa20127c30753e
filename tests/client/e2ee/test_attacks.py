"""What a relay without the secret tries: forged comings and goings, other labels, mirrors."""

import random
from dataclasses import replace

import pytest

pytest.importorskip("cryptography", reason="needs the extra seal")

from helpers.sealed_room import DELAY_S, SECRET, Room, full_room
from pica_client.e2ee.guard import YOUNG_KEY_S, Guard
from pica_client.e2ee.peer_keys import FIRST_WAIT_S, SILENT_S
from pica_client.e2ee.secret import RoomSecret, SealState
from pica_protocol.frames import Frame
from pica_protocol.messages import Peer, PeerAway, PeerJoined, PeerLeft, Track, Whisper
from pica_protocol.session import ClientEvent, Closed

pytestmark = pytest.mark.unit


def tell(room: Room, name: str, *events: ClientEvent) -> None:
    """The relay says something to one member alone."""
    member = room.members[name]
    for event in events:
        member.take(member.guard.receive_event(event, room.now))


def state(room: Room, name: str, of: str) -> SealState:
    return room.members[name].guard.status.peers[of]


def come_again(room: Room, name: str, forged: str) -> None:
    """Pretend to one member that another one came back, or left and came."""
    peer = room.members["ben"].peer
    told = {"peer_back": (PeerAway(peer_id="ben", is_away=False),)}.get(
        forged, (PeerLeft(peer_id="ben"), PeerJoined(peer=peer))
    )
    tell(room, name, *told)


@pytest.mark.parametrize("forged", ["peer_back", "peer_left and peer_joined"])
def test_no_frame_opens_again_after_a_forged_return(forged: str) -> None:
    room = full_room("ada", "ben")
    shown = [room.send("ben", bytes([number])) for number in range(5)]
    held_back = room.seal("ben", b"held back")
    notes = [whispered for whispered in room.whispers if whispered[:2] == ("ben", "ada")]
    come_again(room, "ada", forged)
    for whispered in notes:
        room.deliver(*whispered)
        assert not any(room.show("ada", frame) for frame in [*shown, held_back])
    room.run(1)
    for whispered in notes:
        room.deliver(*whispered)
    assert not any(room.show("ada", frame) for frame in [*shown, held_back])


def test_a_frame_does_not_open_on_two_connections_of_its_receiver() -> None:
    room = full_room("ada", "ben")
    room.leave("ben")
    ben = room.join("ben")
    room.run(4 * DELAY_S)
    shown = room.send("ada", b"once")
    assert ben.frames[-1].payload == b"once"
    # The connection breaks, and ada is not told: her key is younger than a second.
    tell(room, "ben", Closed(code=1006, reason="", is_remote=True))
    tell(room, "ben", replace(ben.joined, peers=(room.members["ada"].peer,)))
    room.run(4 * DELAY_S)
    assert not room.show("ben", shown)
    room.send("ada", b"and on")
    assert ben.frames[-1].payload == b"and on"


def test_a_key_given_on_another_id_of_one_receiver_opens_from_its_next_frame_only() -> None:
    room = Room()
    room.join("ada")
    room.join("ben")
    room.run(4 * DELAY_S)
    shown = room.send("ada", b"once")
    ben = room.members.pop("ben")  # reconnects, and ada is not told that he left
    again = room.join("ben2", guard=ben.guard)
    room.run(4 * DELAY_S)
    assert room.members["ada"].guard.stats()["key_changes"] == 1
    assert not room.show("ben2", shown)
    room.send("ada", b"and on")
    assert again.frames[-1].payload == b"and on"


@pytest.mark.parametrize("forged", ["peer_back", "peer_left and peer_joined"])
def test_a_forged_return_costs_its_victim_no_change_of_keys_and_heals(forged: str) -> None:
    room = full_room("ada", "ben", "cho")
    room.run(YOUNG_KEY_S)
    come_again(room, "ada", forged)
    changes = room.members["ben"].guard.counters.key_changes
    room.run(FIRST_WAIT_S + 4 * DELAY_S)
    assert room.members["ben"].guard.counters.key_changes == changes
    assert state(room, "ada", "ben") is SealState.VERIFIED
    for sender in ("ada", "ben", "cho"):
        frame = room.send(sender)
        others = [member for name, member in room.members.items() if name != sender]
        assert all(member.frames[-1].stream == frame.stream for member in others)


LABELS = {
    "name": lambda peer: replace(peer, name="Bob"),
    "avatar": lambda peer: with_track(peer, avatar="ab" * 32),
    "kind": lambda peer: with_track(peer, kind="voice"),
    "deadline": lambda peer: with_track(peer, deadline_ms=200),
    "stream": lambda peer: with_track(peer, stream=99),
    "no track": lambda peer: replace(peer, tracks=()),
}


def with_track(peer: Peer, **changed: object) -> Peer:
    return replace(peer, tracks=(replace(peer.tracks[0], **changed),))


@pytest.mark.parametrize("label", LABELS)
def test_who_is_relabelled_is_not_opened_and_said_to_be(label: str) -> None:
    room = full_room("ada", "ben")
    truth = room.members["ben"].peer
    tell(room, "ada", PeerLeft(peer_id="ben"), PeerJoined(peer=LABELS[label](truth)))
    room.run(10)
    frame = room.seal("ben")
    for stream in (truth.tracks[0].stream, 99):
        assert not room.show("ada", replace(frame, stream=stream))
    assert state(room, "ada", "ben") is SealState.RELABELLED
    tell(room, "ada", PeerLeft(peer_id="ben"), PeerJoined(peer=truth))
    room.run(10)
    room.send("ben", b"ben again")
    assert room.members["ada"].frames[-1].payload == b"ben again"


def test_keys_are_bound_to_the_room_that_was_asked_for() -> None:
    room = full_room("ada")
    ben = room.join("ben", asks_for="another room")  # and the relay puts him into this one
    room.run(10)
    room.send("ada")
    room.send("ben")
    assert ben.frames == room.members["ada"].frames == []
    assert state(room, "ada", "ben") is SealState.SECRET_DIFFERS


def test_a_member_with_the_public_key_of_another_is_not_believed() -> None:
    room = full_room("ada", "ben")
    as_ben = random.Random("ben/2").randbytes  # what `Room` gave him
    room.join("mallory", guard=Guard(SECRET, random_bytes=as_ben))
    room.run(3)
    assert room.members["ada"].guard.status.verified == {"ben"}


def test_whoever_can_read_us_is_in_the_code_and_counts_when_it_has_shown_itself() -> None:
    room = full_room("ada", "ben")
    before = room.members["ada"].guard.status.code
    room.fate = lambda whispered: whispered[0] != "mallory" or whispered[2][53:57] == bytes(4)
    room.join("mallory")  # has the secret, takes keys, and says nothing more
    room.run(3)
    ada = room.members["ada"].guard
    assert ada.status.verified == {"ben"}
    assert ada.status.code not in (before, "")
    assert ada.status.code == room.members["ben"].guard.status.code


def test_everybody_has_the_same_code_and_another_one_when_somebody_is_inserted() -> None:
    room = full_room("ada", "ben", "cho")
    codes = {member.guard.status.code for member in room.members.values()}
    assert len(codes) == 1
    (before,) = codes
    assert [len(group) for group in before.split()] == [5] * 6
    assert before.replace(" ", "").isdecimal()
    room.join("mallory")  # has the secret
    room.run(3)
    codes = {member.guard.status.code for member in room.members.values()}
    assert len(codes) == 1
    assert before not in codes
    room.leave("mallory")
    assert room.members["ada"].guard.status.code == before


def test_who_stands_between_two_gives_them_two_codes() -> None:
    """Mallory has the secret, and the relay shows her to each of two as the other."""
    left, right = Room(), Room()
    for room, honest, posed in ((left, "ada", "ben"), (right, "ben", "ada")):
        room.join(honest)
        room.join(posed)
        room.run(3)
        assert state(room, honest, posed) is SealState.VERIFIED
    assert left.members["ada"].guard.status.code != right.members["ben"].guard.status.code


def test_why_somebody_is_not_opened_is_said() -> None:
    room = full_room("ada", "ben")
    room.join("eve", secret=RoomSecret(bytes(32)))
    plain = Peer(peer_id="plain", name="P", tracks=(Track(kind="face", stream=50),))
    tell(room, "ada", PeerJoined(peer=plain), Whisper(peer_id="ben", data=b"made up"))
    assert state(room, "ada", "plain") is SealState.WAITING
    room.run(2 * SILENT_S)
    frame = Frame(stream=50, sequence=0, captured_us=0, payload=b"a plain face")
    assert not room.show("ada", frame)
    said = room.members["ada"].guard.stats()["peers"]
    assert said == {"ben": "verified", "eve": "secret differs", "plain": "plain"}


def test_two_who_are_both_fed_what_they_said_in_an_earlier_stay_find_each_other() -> None:
    room = full_room("ada", "ben")
    old = list(room.whispers)
    for name in ("ada", "ben"):
        room.leave(name)
    for name in ("ada", "ben"):
        room.join(name)
    for whispered in old:
        room.deliver(*whispered)
    room.run(5)
    assert state(room, "ada", "ben") is state(room, "ben", "ada") is SealState.VERIFIED
    for sender, receiver in (("ada", "ben"), ("ben", "ada")):
        room.send(sender, b"still here")
        assert room.members[receiver].frames[-1].payload == b"still here"
