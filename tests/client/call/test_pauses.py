"""One person over several seats, and a face after a pause."""

from __future__ import annotations

import pytest

from helpers.senders import LoadedAvatars
from helpers.toy import make_toy_avatar, toy_payload
from pica_client.call.call import Call
from pica_client.tracks import FACE_KEY, FACE_LOST
from pica_protocol.frames import Frame
from pica_protocol.messages import (
    Joined,
    Peer,
    PeerJoined,
    PeerLeft,
    PeerUpdated,
    Track,
)

pytestmark = pytest.mark.unit

TOY_ID = "1" * 64
TOY = make_toy_avatar()
PAYLOAD = toy_payload(TOY)


def ada(peer_id: str, stream: int) -> Peer:
    track = Track(kind="face", avatar=TOY_ID, stream=stream)
    return Peer(peer_id=peer_id, name="Ada", tracks=(track,))


@pytest.fixture
def call() -> Call:
    made = Call(LoadedAvatars({TOY_ID: TOY}))
    made.receive_event(Joined(room="r", peer_id="me", peers=(ada("p1", 1),)), now=0.0)
    return made


def send_ada(call: Call, begin_s: float, end_s: float, stream: int = 1) -> None:
    """Ada sends 30 frames a second, on a clock that is an hour ahead."""
    for index in range(round(begin_s * 30), round(end_s * 30)):
        send_frame(call, index, stream)


def send_frame(call: Call, index: int, stream: int = 1, *, now: float | None = None) -> None:
    captured_us = index * 1_000_000 // 30 + 3_600_000_000
    sent = Frame(stream=stream, sequence=index, captured_us=captured_us, payload=PAYLOAD)
    call.receive_event(sent, now=index / 30 if now is None else now)


def test_who_comes_back_to_another_seat_is_counted_as_one_person(call: Call) -> None:
    call.begin_window(0.0)
    send_ada(call, 0, 2)
    call.receive_event(PeerLeft(peer_id="p1", reason="lost"), now=12.0)
    call.receive_event(PeerJoined(peer=ada("p2", 2)), now=25.0)
    send_ada(call, 25, 27, stream=2)
    call.receive_event(Joined(room="r", peer_id="me", peers=(ada("p7", 4),)), now=29.0)
    send_ada(call, 29, 30, stream=4)
    (stats,) = call.stats(30.0)["peers"]
    assert stats["received"] == 150


def test_the_clocks_of_two_machines_may_differ(call: Call) -> None:
    send_ada(call, 0, 2)
    call.faces(2.0)
    (stats,) = call.stats(2.0)["peers"]
    assert stats["age_ms"] < 100


def ages_s(call: Call, begin_s: float, end_s: float) -> list[float]:
    """How old the face is, a hundred times a second, by the clock of who sends."""
    moments = [begin_s + index / 100 for index in range(round((end_s - begin_s) * 100))]
    return [now + 3600 - call.faces(now)[0].captured_us / 1e6 for now in moments]


@pytest.mark.parametrize("backlog_s", [0.0, 0.05, 0.7])
def test_soon_after_a_thaw_the_face_is_that_of_now(call: Call, backlog_s: float) -> None:
    """Eight seconds of frames come at once, or as fast as they can be decoded."""
    thaw_s, fresh_s = 10.0, 10.0 + backlog_s
    send_ada(call, 0, 2)
    ages_s(call, 1.9, 2.0)
    waiting = range(60, round(fresh_s * 30))
    seen = []
    for place, index in enumerate(waiting):
        now = thaw_s + backlog_s * place / len(waiting)
        send_frame(call, index, now=now)
        seen.append(call.faces(now)[0].captured_us / 1e6 - 3600)
    for index in range(waiting.stop, waiting.stop + 60):
        send_frame(call, index)
        seen.append(call.faces(index / 30 + 0.001)[0].captured_us / 1e6 - 3600)
        assert index / 30 - seen[-1] < 0.15 or index < waiting.stop + 4
    (stats,) = call.stats(fresh_s + 2)["peers"]
    assert (stats["lost"], stats["restarts"], stats["refused"]) == (0, 0, 0)
    assert stats["playout_delay_ms"] == pytest.approx(33.3, abs=1)


def test_a_face_is_away_while_its_tracker_sees_nobody(call: Call) -> None:
    send_frame(call, 0)
    statuses = []
    for says in (FACE_LOST, "", "odd"):
        metadata = ((FACE_KEY, says),)
        call.receive_event(PeerUpdated(peer_id="p1", metadata=metadata), now=0.0)
        statuses.append(call.faces(0.1)[0].status)
    assert statuses == ["away", "live", "live"]
