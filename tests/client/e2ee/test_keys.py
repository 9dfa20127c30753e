"""Who can open what, when: joining, leaving, lost whispers, lies."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("cryptography", reason="needs the extra seal")

from helpers.sealed_room import DELAY_S, SECRET, Room, Whispered
from pica_client.e2ee import keys
from pica_client.e2ee.errors import NoteError, SealError
from pica_client.e2ee.frames import decode_header
from pica_client.e2ee.guard import Guard
from pica_client.e2ee.keys import (
    FRAMES_PER_KEY,
    LATE_FRAMES_S,
    LONGEST_WAIT_S,
    NOTES_AT_ONCE,
    YOUNG_KEY_S,
    KeyExchange,
)
from pica_client.e2ee.notes import (
    NOTE_BYTES,
    Note,
    RoomKeys,
    decode_note,
    encode_note,
)
from pica_client.e2ee.peer_keys import FIRST_WAIT_S
from pica_client.e2ee.secret import RoomSecret
from pica_client.e2ee.suites import AES_128_CTR_HMAC_SHA256_64
from pica_protocol.frames import Frame
from pica_protocol.limits import MAX_WHISPER_BYTES
from pica_protocol.messages import Joined, Peer, PeerJoined, PeerLeft, Track, Whisper
from pica_protocol.session import Closed

pytestmark = pytest.mark.unit

OTHER_SECRET = RoomSecret(bytes(32))
NOTE_KEY = RoomKeys.of(SECRET, "r").note_key


def full_room(*names: str) -> Room:
    """Everybody is there, has everybody's key, and has sent for a while."""
    room = Room()
    for name in names:
        room.join(name)
    room.run(2)
    for name in names:
        room.send(name)
    room.run(2)
    return room


def note_of(whispered: Whispered) -> Note:
    sender, receiver, data = whispered
    return decode_note(data, NOTE_KEY, sender, receiver)


def test_everybody_opens_everybody() -> None:
    room = full_room("ada", "ben", "cho")
    for name in room.members:
        room.send(name, name.encode())
    for name, member in room.members.items():
        others = sorted(set(room.members) - {name})
        assert sorted(frame.payload.decode() for frame in member.frames[-2:]) == others
        assert member.guard.counters.unreadable == 0
        assert member.guard.members == set(others)


def test_a_mere_viewer_opens_everybody() -> None:
    room = Room()
    room.join("ada")
    viewer = room.join("viewer", publishes=False)
    room.run(1)
    room.send("ada")
    assert len(viewer.frames) == 1


def test_outside_a_room_nothing_is_sealed() -> None:
    with pytest.raises(SealError, match="no key to seal with"):
        Guard(SECRET).seal(Frame(stream=1, sequence=0, captured_us=0, payload=b""))


def test_a_quiet_room_falls_silent() -> None:
    room = full_room("ada", "ben", "cho")
    room.run(LATE_FRAMES_S)
    num_whispers = len(room.whispers)
    room.run(3600)
    assert len(room.whispers) == num_whispers
    assert all(member.guard.next_timer() is None for member in room.members.values())


def test_two_peers_agree_within_three_notes_each() -> None:
    room = Room()
    room.join("ada")
    room.join("ben")
    room.run(60)
    assert [sender for sender, _, _ in room.whispers] == ["ada", "ben"] * 3
    assert all(len(data) in NOTE_BYTES for _, _, data in room.whispers)
    assert max(NOTE_BYTES) <= MAX_WHISPER_BYTES


def test_a_joiner_opens_frames_one_round_trip_after_it_came() -> None:
    room = full_room("ada", "ben")
    came_s = room.now
    cho = room.join("cho")
    room.run(2 * DELAY_S)
    room.send("ada")
    assert [frame.captured_us for frame in cho.frames] == [round((came_s + 2 * DELAY_S) * 1e6)]


def test_a_publisher_hears_that_a_newcomer_needs_a_keyframe() -> None:
    room = full_room("ada", "ben")
    ada = room.members["ada"]
    before = ada.keyframe_requests
    room.join("viewer", publishes=False)
    room.run(5)
    assert ada.keyframe_requests == before + 1


def test_a_joiner_opens_nothing_from_before_it_came() -> None:
    room = full_room("ada", "ben")
    old = [room.send("ada") for _ in range(3)]
    room.run(YOUNG_KEY_S)
    room.join("cho")
    room.run(2)
    assert not any(room.show("cho", frame) for frame in old)
    room.send("ada")
    assert len(room.members["cho"].frames) == 1


def test_a_leavers_keys_open_nothing_that_is_sent_after() -> None:
    room = full_room("ada", "ben", "mallory")
    mallory = room.leave("mallory")
    after = [room.send("ada", b"secret") for _ in range(3)]
    assert [frame.payload for frame in room.members["ben"].frames[-3:]] == [b"secret"] * 3
    for frame in after:
        assert mallory.guard.receive_event(frame, room.now) == []
    # Not even with every whisper that went between the others.
    for sender, _, data in room.whispers:
        mallory.guard.receive_event(Whisper(peer_id=sender, data=data), room.now)
    for frame in after:
        assert mallory.guard.receive_event(frame, room.now) == []


def test_a_leavers_keys_open_nothing_though_the_relay_made_up_crowds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(keys, "MAX_FLOORS", 8)
    room = full_room("ada", "mallory")
    ada = room.members["ada"].guard
    for number in range(9):
        ghost = Peer(peer_id=f"ghost{number}", name="Xen")
        ada.receive_event(PeerJoined(peer=ghost), room.now)
        ada.receive_event(PeerLeft(peer_id=ghost.peer_id), room.now)
    mallory = room.leave("mallory")
    assert mallory.guard.receive_event(room.send("ada", b"secret"), room.now) == []


def test_who_had_no_key_may_leave_without_any_change() -> None:
    room = full_room("ada", "ben")
    changes = room.members["ada"].guard.stats()["key_changes"]
    room.join("mallory", secret=OTHER_SECRET)
    room.run(5)
    room.leave("mallory")
    room.run(5)
    assert room.members["ada"].guard.stats()["key_changes"] == changes


def test_a_replaced_key_opens_late_frames_for_a_while_only() -> None:
    room = full_room("ada", "ben", "cho")
    late, later = room.seal("ada"), room.seal("ada")
    room.leave("cho")
    room.run(1)
    assert room.show("ben", late)
    room.run(LATE_FRAMES_S)
    assert not room.show("ben", later)
    assert room.members["ben"].guard.counters.unreadable == 1


def test_frames_in_another_order_open_once_each() -> None:
    room = full_room("ada", "ben")
    frames = [room.seal("ada", bytes([i])) for i in range(40)]
    random.Random(1).shuffle(frames)
    assert all(room.show("ben", frame) for frame in frames)
    assert not any(room.show("ben", frame) for frame in frames)
    assert room.members["ben"].guard.counters.replayed == 40


def test_a_frame_that_was_moved_or_relabelled_does_not_open() -> None:
    room = full_room("ada", "ben", "cho")
    frame = room.seal("ada")
    stream_of_cho = room.members["cho"].joined.tracks[0].stream
    wrong = [
        replace(frame, stream=stream_of_cho),
        replace(frame, sequence=frame.sequence + 1),
        replace(frame, captured_us=frame.captured_us + 1),
        replace(frame, layer=1),
        replace(frame, is_keyframe=True),
        replace(frame, payload=b"a plain face"),
        replace(frame, payload=b""),
        replace(frame, stream=999),
    ]
    ben = room.members["ben"].guard.counters
    assert not any(room.show("ben", each) for each in wrong)
    assert (ben.forged, ben.unreadable) == (6, 2)  # a plain face and a stream of nobody: no key
    assert room.show("ben", frame)  # a forgery uses up no counter


def test_a_key_changes_before_its_counters_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pica_client.e2ee.keys.FRAMES_PER_KEY", 20)
    room = full_room("ada", "ben")
    seen = set()
    for _ in range(65):
        key_id, counter, _ = decode_header(room.send("ada").payload)
        assert counter < 20
        seen.add((room.members["ada"].guard.stats()["key_changes"], key_id, counter))
    assert len(seen) == 65
    assert room.members["ben"].guard.counters.unreadable == 0
    assert room.members["ben"].guard.counters.opened >= 65


def test_counters_stay_within_two_bytes_and_a_header_within_three() -> None:
    assert FRAMES_PER_KEY == 2**16
    room = full_room("ada", "ben")
    for _ in range(300):
        frame = room.seal("ada", b"twelve bytes")
        assert len(frame.payload) <= 12 + 3 + 16


def test_short_tags_are_announced_with_the_key() -> None:
    room = Room()
    room.join("ada", suite=AES_128_CTR_HMAC_SHA256_64)
    room.join("ben")
    room.run(1)
    frame = room.send("ada", b"twelve bytes")
    assert room.members["ben"].frames[-1].payload == b"twelve bytes"
    assert len(frame.payload) == 12 + 1 + 8
    room.send("ben", b"long tag")
    assert room.members["ada"].frames[-1].payload == b"long tag"


def test_without_the_secret_nobody_opens_anything_and_is_asked_ever_less() -> None:
    room = full_room("ada", "ben")
    mallory = room.join("mallory", secret=OTHER_SECRET)
    room.run(600)
    room.send("ada")
    room.send("mallory")
    assert mallory.frames == []
    assert all(
        frame.stream != mallory.joined.tracks[0].stream for frame in room.members["ada"].frames
    )
    assert "mallory" not in room.members["ada"].guard.members
    asked = sum(sender == "ada" and to == "mallory" for sender, to, _ in room.whispers)
    assert asked <= 600 / LONGEST_WAIT_S + 10
    assert room.members["ada"].guard.counters.notes_refused > 0


def test_the_same_secret_in_another_room_is_another_secret() -> None:
    assert RoomKeys.of(SECRET, "r") != RoomKeys.of(SECRET, "s")
    data = encode_note(Note(public_key=bytes(32)), RoomKeys.of(SECRET, "s").note_key, "a", "b")
    with pytest.raises(NoteError, match="without the secret"):
        decode_note(data, NOTE_KEY, "a", "b")


def test_a_note_is_for_one_receiver_from_one_sender() -> None:
    data = encode_note(Note(public_key=bytes(32)), NOTE_KEY, "ada", "ben")
    assert decode_note(data, NOTE_KEY, "ada", "ben") == Note(public_key=bytes(32))
    for way in (("ben", "ada"), ("ada", "cho"), ("cho", "ben"), ("adab", "en")):
        with pytest.raises(NoteError):
            decode_note(data, NOTE_KEY, *way)


@given(st.binary(max_size=120) | st.binary(min_size=68, max_size=68))
def test_any_bytes_are_refused_as_a_note(data: bytes) -> None:
    with pytest.raises(NoteError):
        decode_note(data, NOTE_KEY, "a", "b")


def test_no_flipped_bit_of_a_note_is_believed() -> None:
    note = Note(public_key=bytes(32), generation=3, suite=4, wrapped_key=bytes(32))
    data = encode_note(note, NOTE_KEY, "a", "b")
    assert decode_note(data, NOTE_KEY, "a", "b") == note
    for place in range(len(data) * 8):
        flipped = bytearray(data)
        flipped[place // 8] ^= 1 << place % 8
        with pytest.raises(NoteError):
            decode_note(bytes(flipped), NOTE_KEY, "a", "b")


def test_a_member_with_a_public_key_of_small_order_is_refused() -> None:
    room = full_room("ada", "ben")
    mallory = room.join("mallory", secret=OTHER_SECRET)
    data = encode_note(Note(public_key=bytes(32)), NOTE_KEY, "mallory", "ada")
    refused = room.members["ada"].guard.counters.notes_refused
    room.deliver("mallory", "ada", data)
    assert room.members["ada"].guard.counters.notes_refused == refused + 1
    assert "mallory" not in room.members["ada"].guard.members
    assert mallory.frames == []


def test_lost_notes_are_sent_again_until_everybody_has_every_key() -> None:
    chance = random.Random(7)
    room = Room(fate=lambda whispered: chance.random() < 0.4)
    for name in ("ada", "ben", "cho", "dee"):
        room.join(name)
        room.run(0.2)
    room.run(60)
    for name in room.members:
        room.send(name)
    assert all(len(member.frames) == 3 for member in room.members.values())


def test_a_frame_without_a_key_makes_its_receiver_ask_at_a_limited_rate() -> None:
    room = full_room("ada", "ben", "cho")
    room.fate = lambda whispered: 0
    room.leave("cho")
    room.run(60)  # ada's new key is lost again and again: its notes have become rare
    num_whispers = len(room.whispers)
    for _ in range(60):
        room.show("ben", room.seal("ada"))
        room.run(1 / 30)
    asked = [w for w in room.whispers[num_whispers:] if w[0] == "ben"]
    assert 1 <= len(asked) <= 3
    assert note_of(asked[0]).wants_answer
    room.fate = lambda whispered: 1
    room.show("ben", room.seal("ada"))
    room.run(1.5)
    assert room.show("ben", room.seal("ada"))


def test_whispers_that_the_relay_repeats_change_nothing() -> None:
    room = full_room("ada", "ben", "cho")
    room.leave("cho")
    room.run(1)
    for whispered in list(room.whispers):
        for _ in range(2):
            room.deliver(*whispered)
    room.run(5)
    room.send("ada", b"still")
    room.send("ben", b"well")
    assert room.members["ben"].frames[-1].payload == b"still"
    assert room.members["ada"].frames[-1].payload == b"well"
    assert room.members["ada"].guard.members == {"ben"}


def test_an_old_note_under_a_reused_peer_id_gives_way_to_the_fresh_one() -> None:
    room = full_room("ada", "ben")
    hello = next(w for w in room.whispers if w[:2] == ("ben", "ada"))
    room.leave("ben")
    room.run(5)
    ben = room.join("ben")
    room.deliver(*hello)  # the relay repeats what another ben said
    room.run(5)
    room.send("ada", b"hello again")
    assert ben.frames[-1].payload == b"hello again"


def test_a_peer_that_came_back_unseen_is_met_again() -> None:
    room = full_room("ada", "ben")
    ben = room.members["ben"]
    ben.take(ben.guard.receive_event(Closed(code=1006, reason="", is_remote=True), room.now))
    room.run(1)
    assert not room.show("ben", room.seal("ada"))
    joined = replace(ben.joined, peers=(room.members["ada"].peer,))
    ben.take(ben.guard.receive_event(joined, room.now))
    room.run(1)
    room.send("ada", b"to ben")
    room.send("ben", b"to ada")
    assert ben.frames[-1].payload == b"to ben"
    assert room.members["ada"].frames[-1].payload == b"to ada"


def test_a_public_key_that_was_given_up_does_not_come_back() -> None:
    room = full_room("ada", "ben")
    ben, ada = room.members["ben"], room.members["ada"]
    room.send("ben")
    for _ in range(2):  # the relay hides that ben left and came again
        joined = replace(ben.joined, peers=(ada.peer,))
        ben.take(ben.guard.receive_event(joined, room.now))
        room.run(1)
    frame = room.send("ben", b"once")
    assert ada.frames[-1].payload == b"once"
    for whispered in list(room.whispers):
        room.deliver(*whispered)
    assert not room.show("ada", frame)
    room.send("ben", b"more")
    assert ada.frames[-1].payload == b"more"


def test_no_key_is_used_in_two_stays() -> None:
    room = full_room("ada", "ben")
    first = room.seal("ada")
    ada = room.leave("ada")
    again = room.join("ada", guard=ada.guard)
    room.run(1)
    assert again.guard.stats()["key_changes"] > 1
    second = room.seal("ada")
    assert decode_header(second.payload)[:2] != decode_header(first.payload)[:2]


def test_the_largest_room_keeps_to_the_rate_of_notes() -> None:
    room = Room()
    for number in range(64):
        room.join(f"p{number}", publishes=number < 8)
    start = room.now
    sent = {f"p{number}": 0 for number in range(64)}
    room.run(1)
    for sender, _, _ in room.whispers:
        sent[sender] += 1
    assert max(sent.values()) <= NOTES_AT_ONCE + 13
    room.run(60)
    assert room.now == start + 61
    for number in range(8):
        room.send(f"p{number}")
    for name, member in room.members.items():
        assert len(member.frames) == (7 if int(name[1:]) < 8 else 8)


@settings(max_examples=60)
@given(st.data())
def test_whoever_is_in_the_room_opens_and_whoever_is_not_does_not(data: st.DataObject) -> None:
    chance = random.Random(data.draw(st.integers(0, 2**32)))
    loss = data.draw(st.sampled_from([0.0, 0.3]))
    room = Room(fate=lambda whispered: chance.choices([0, 1, 2], [loss, 0.9 - loss, 0.1])[0])
    names = ["ada", "ben", "cho", "dee"]
    gone: list[tuple[float, Guard]] = []
    for _ in range(data.draw(st.integers(1, 12))):
        name = data.draw(st.sampled_from(names))
        if name in room.members:
            gone.append((room.now, room.leave(name).guard))
        else:
            room.join(name)
        for sender in list(room.members):
            frame = room.send(sender)
            for _, guard in gone:
                assert guard.receive_event(frame, room.now) == []
        room.run(data.draw(st.sampled_from([0.0, 0.05, 1.0, 3.0])))
    room.fate = lambda whispered: 1
    room.run(2 * LONGEST_WAIT_S)
    for name in list(room.members):
        frame = room.seal(name)
        assert all(room.show(other, frame) for other in room.members if other != name)
    counted = [member.guard.counters for member in room.members.values()]
    assert all(counters.forged == 0 for counters in counted)


def test_nobody_is_waited_for_in_a_room_of_one() -> None:
    room = Room()
    ada = room.join("ada")
    room.send("ada")
    assert ada.guard.next_timer() is None
    assert room.whispers == []
    assert FIRST_WAIT_S < LONGEST_WAIT_S


def test_a_peer_beyond_the_limit_of_the_room_is_not_remembered() -> None:
    keys = KeyExchange(SECRET, random_bytes=bytes)
    keys.begin("r", "me")
    keys.receive_joined(
        Joined(room="r", peer_id="me", tracks=(Track(kind="face", stream=1),), peers=()), now=0.0
    )
    for number in range(100):
        keys.receive_peer_joined(Peer(peer_id=f"p{number}", name="p"), now=0.0)
    with pytest.raises(NoteError, match="nobody in the room"):
        keys.receive_note("p99", bytes(68), now=0.0)


def test_frames_of_a_peer_without_the_secret_ask_for_nothing() -> None:
    guard = Guard(SECRET, random_bytes=bytes)
    guard.begin("r", "me")
    peer = Peer(peer_id="mallory", name="m", tracks=(Track(kind="face", stream=2),))
    guard.receive_event(Joined(room="r", peer_id="me", peers=(peer,)), 0.0)
    guard.messages_to_send(0.0)
    before = guard.next_timer()
    frame = Frame(stream=2, sequence=0, captured_us=0, payload=b"plain")
    assert guard.receive_event(frame, 0.1) == []
    assert guard.next_timer() == before
