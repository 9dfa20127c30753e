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


def test_a_face_is_away_while_its_tracker_sees_nobody(call: Call) -> None:
    send_frame(call, 0)
    statuses = []
    for says in (FACE_LOST, "", "odd"):
        metadata = ((FACE_KEY, says),)
        call.receive_event(PeerUpdated(peer_id="p1", metadata=metadata), now=0.0)
        statuses.append(call.faces(0.1)[0].status)
    assert statuses == ["away", "live", "live"]
