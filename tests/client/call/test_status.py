"""The list of people, what is said of them, and why a face is not to be seen."""

from dataclasses import replace

import pytest

from helpers.senders import LoadedAvatars
from helpers.toy import make_toy_avatar, toy_payload
from pica_client.call.call import Call
from pica_client.call.roster import Member, News
from pica_client.call.status import duration_text, notices, recorders
from pica_protocol.frames import Frame
from pica_protocol.messages import (
    Joined,
    Peer,
    PeerAway,
    PeerJoined,
    PeerLeft,
    PeerUpdated,
    StreamMuted,
    Track,
    Whisper,
)

pytestmark = pytest.mark.unit

TOY_ID = "a" * 64


def person(peer_id: str, name: str, stream: int) -> Peer:
    track = Track(kind="face", avatar=TOY_ID, stream=stream)
    return Peer(peer_id=peer_id, name=name, tracks=(track,))


def call_with(*peers: Peer) -> Call:
    call = Call(LoadedAvatars({TOY_ID: make_toy_avatar()}))
    call.own_name = "Me"
    call.receive_event(Joined(room="r", peer_id="me", peers=peers), now=0.0)
    return call


def listed(call: Call, now: float = 1.0) -> dict[str, Member]:
    return {each.name: each for each in call.room(now).participants}


def test_who_may_be_somebody_else_than_the_name_says_is_marked() -> None:
    assured = replace(person("p1", "Ada", 1), is_name_assured=True, identity="ada")
    people = listed(call_with(assured, person("p2", "Ada", 2), person("p3", "ＭＥ", 3)))
    assert people["Ada"].warning == ""
    assert people["Ada (2)"].warning == "not the assured Ada"
    assert people["ＭＥ"].warning == "looks like your name"


def test_a_token_may_give_us_another_name() -> None:
    call = call_with()
    call.receive_event(Joined(room="r", peer_id="me", name="Dr. Me"), now=1.0)
    assert call.own_name == "Dr. Me"


def test_people_of_one_name_are_told_apart_and_keep_their_numbers() -> None:
    call = call_with(person("p1", "Ada", 1), person("p2", "Ada", 2), person("p3", "Me", 3))
    assert list(listed(call)) == ["Ada", "Ada (2)", "Me (2)"]
    call.receive_event(PeerLeft(peer_id="p1"), now=1.0)
    assert list(listed(call)) == ["Ada (2)", "Me (2)"]
    call.receive_event(PeerJoined(peer=person("p4", "Ada", 4)), now=2.0)
    assert list(listed(call)) == ["Ada", "Ada (2)", "Me (2)"]


@pytest.mark.parametrize(
    ("event", "line"),
    [
        (None, "no face yet"),
        (PeerUpdated(peer_id="p1", metadata=(("face", "muted"),)), "face is off"),
        (PeerUpdated(peer_id="p1", metadata=(("face", "odd"),)), "no face yet"),
        (PeerAway(peer_id="p1", is_away=True), "connection lost"),
        (StreamMuted(stream=1, is_muted=True), "muted by an admin"),
        (Whisper(peer_id="p1", data=b"a key"), "encrypted: the room's secret is needed"),
    ],
)
def test_there_is_a_reason_for_a_face_that_is_not_to_be_seen(event: object, line: str) -> None:
    call = call_with(person("p1", "Ada", 1))
    if event is not None:
        call.receive_event(event, now=0.5)  # type: ignore[arg-type]
    assert listed(call)["Ada"].line == line
    assert call.faces(1.0)[0].note == line  # under the face as in the list


def test_a_watcher_is_said_to_watch_and_a_poor_connection_is_told_last() -> None:
    ada = Member(peer=Peer(peer_id="p1", name="Ada"))
    assert ada.line == "watching"
    assert replace(ada, note="connection lost").line == "connection lost"
    seen = replace(ada, peer=person("p1", "Ada", 1))
    assert (seen.line, replace(seen, quality="poor").line) == ("", "poor connection")


def test_who_records_is_named_oneself_too() -> None:
    call = call_with(person("p1", "Ada", 1), Peer(peer_id="p2", name="Ben"))
    call.receive_event(PeerUpdated(peer_id="p2", metadata=(("records", "yes"),)), now=1.0)
    me = Member(peer=Peer(peer_id="me", name="Me", metadata=(("records", "yes"),)))
    assert recorders([me, *listed(call).values()]) == ["You", "Ben"]


def test_what_happened_to_several_is_one_line() -> None:
    news = [News("joined", name) for name in ("Ada", "Ben", "Cho", "Dee")]
    news += [News("left", name) for name in ("Eve", "Fay", "Gil")]
    news += [News("records", "Ada"), News("records", "Ben")]
    assert notices(news) == [
        ("Ada, Ben and 2 others joined", "plain"),
        ("Eve, Fay and Gil left", "plain"),
        ("Ada and Ben record the call", "alert"),
    ]
    assert notices([News("records", "Ada")]) == [("Ada records the call", "alert")]
    assert notices([]) == []


@pytest.mark.parametrize(
    ("seconds", "text"), [(0, "0:00"), (247.9, "4:07"), (3723, "1:02:03"), (-1, "0:00")]
)
def test_how_long_a_call_has_lasted_reads_like_a_clock(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text


def test_what_is_encrypted_is_not_drawn_without_the_secret() -> None:
    call = call_with(person("p1", "Ada", 1))
    # Ciphertext that happens to be a latent: one in some seconds of frames is.
    payload = toy_payload(1.0)
    call.receive_event(Frame(stream=1, sequence=0, captured_us=0, payload=payload), now=1.0)
    assert call.faces(1.2)[0].latent is not None
    call.receive_event(Whisper(peer_id="p1", data=b"a note about keys"), now=1.3)
    call.receive_event(Frame(stream=1, sequence=1, captured_us=40_000, payload=payload), now=1.4)
    (face,) = call.faces(1.5)
    assert (face.latent, face.note) == (None, "encrypted: the room's secret is needed")
    assert call.stats(2.0)["peers"][0]["received"] == 1
