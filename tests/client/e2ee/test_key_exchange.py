"""Who can open what, when: joining, leaving, lost whispers, lies."""

import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("cryptography", reason="needs the extra seal")

from helpers.sealed_room import DELAY_S, SECRET, Room, full_room
from pica_client.e2ee.frames import decode_header
from pica_client.e2ee.guard import MESSAGES_AT_ONCE, YOUNG_KEY_S, Guard
from pica_client.e2ee.peer_keys import LATE_FRAMES_S, LONGEST_WAIT_S, MESSAGE_BYTES
from pica_client.e2ee.secret import RoomSecret
from pica_client.errors import SealError
from pica_protocol.frames import Frame
from pica_protocol.limits import MAX_WHISPER_BYTES
from pica_protocol.messages import Whisper
from pica_protocol.session import Closed

pytestmark = pytest.mark.unit

OTHER_SECRET = RoomSecret(bytes(32))


def test_two_peers_agree_within_three_messages_each() -> None:
    room = Room()
    room.join("ada")
    room.join("ben")
    room.run(60)
    assert [sender for sender, _, _ in room.whispers] == ["ada", "ben"] * 3
    assert {len(data) for _, _, data in room.whispers} == {MESSAGE_BYTES}
    assert MESSAGE_BYTES <= MAX_WHISPER_BYTES


def test_outside_a_room_nothing_is_sealed_or_opened() -> None:
    room = full_room("ada", "ben")
    frame, left = room.seal("ben"), room.members["ada"].guard
    left.receive_event(Closed(code=1006, reason="", is_remote=True), room.now)
    assert not room.show("ada", frame)
    for guard in (Guard(SECRET), left):
        with pytest.raises(SealError, match="no key to seal with"):
            guard.seal(Frame(stream=1, sequence=0, captured_us=0, payload=b""))


def test_a_quiet_room_falls_silent() -> None:
    room = full_room("ada", "ben", "cho")
    room.run(LATE_FRAMES_S)
    num_whispers = len(room.whispers)
    room.run(3600)
    assert len(room.whispers) == num_whispers
    assert all(member.guard.next_timer() is None for member in room.members.values())


def test_a_joiner_opens_frames_one_round_trip_after_it_came() -> None:
    room = full_room("ada", "ben")
    came_s = room.now
    cho = room.join("cho")
    room.run(2 * DELAY_S)
    room.send("ada")
    assert [frame.captured_us for frame in cho.frames] == [round((came_s + 2 * DELAY_S) * 1e6)]


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


def test_a_frame_that_was_moved_or_relabelled_does_not_open() -> None:
    room = full_room("ada", "ben", "cho")
    frame = room.seal("ada")
    stream_of_cho = room.members["cho"].joined.tracks[0].stream
    wrong = [
        replace(frame, stream=stream_of_cho),
        replace(frame, sequence=frame.sequence + 1),
        replace(frame, captured_us=frame.captured_us + 100),
        replace(frame, payload=b"a plain face"),
        replace(frame, payload=b""),
        replace(frame, stream=999),
    ]
    ben = room.members["ben"].guard.counters
    assert not any(room.show("ben", each) for each in wrong)
    assert (ben.forged, ben.unreadable) == (4, 2)  # a plain face and a stream of nobody: no key
    assert room.show("ben", frame)  # a forgery uses up no counter


def test_a_key_changes_before_its_counters_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pica_client.e2ee.guard.FRAMES_PER_KEY", 20)
    room = full_room("ada", "ben")
    seen = set()
    for _ in range(65):
        key_id, counter, _ = decode_header(room.send("ada").payload)
        assert counter < 20
        seen.add((room.members["ada"].guard.stats()["key_changes"], key_id, counter))
    assert len(seen) == 65
    assert room.members["ben"].guard.counters.unreadable == 0
    assert room.members["ben"].guard.counters.opened >= 65


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
    assert "mallory" not in room.members["ada"].guard.status.verified
    asked = sum(sender == "ada" and to == "mallory" for sender, to, _ in room.whispers)
    assert asked <= 600 / LONGEST_WAIT_S + 10
    assert room.members["ada"].guard.counters.messages_refused > 0


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


@pytest.mark.slow
def test_the_largest_room_keeps_to_the_rate_of_messages() -> None:
    room = Room()
    for number in range(64):
        room.join(f"p{number}", publishes=number < 8)
    room.run(1)
    senders = [sender for sender, _, _ in room.whispers]
    assert max(map(senders.count, room.members)) <= MESSAGES_AT_ONCE + 13
    room.run(60)
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
