"""What a client does not believe of its relay."""

from dataclasses import replace

import pytest

from pica_protocol.client_session import ClientSession
from pica_protocol.codec import encode_message
from pica_protocol.messages import Joined, Peer, PeerJoined, PeerLeft, Track
from pica_protocol.session import Closed

pytestmark = pytest.mark.unit

OWN = Track(kind="face", stream=7)
BOB = Peer(peer_id="p2", name="Bob", tracks=(Track(kind="face", stream=8),))
JOINED = Joined(room="lobby", peer_id="p1", tracks=(OWN,), peers=(BOB,))


def joined_client() -> ClientSession:
    client = ClientSession(room="lobby", name="Ada", tracks=(replace(OWN, stream=0),), now=0.0)
    assert client.receive_data(encode_message(JOINED), now=0.2) == [JOINED]
    return client


@pytest.mark.parametrize(
    ("joined", "reason"),
    [
        (replace(JOINED, room="attic"), "room attic, not the one asked for"),
        (replace(JOINED, peers=(replace(BOB, peer_id="p1"),)), "a room that has a peer twice"),
        (replace(JOINED, peers=(BOB, BOB)), "a room that has a peer twice"),
        (replace(JOINED, peers=(replace(BOB, tracks=(OWN,)),)), "a room that has a stream twice"),
    ],
    ids=["another room", "ourselves", "twice", "our own stream"],
)
def test_a_client_does_not_join_a_room_that_cannot_be(joined: Joined, reason: str) -> None:
    client = ClientSession(room="lobby", name="Ada", tracks=(replace(OWN, stream=0),), now=0.0)
    (closed,) = client.receive_data(encode_message(joined), 0.1)
    assert isinstance(closed, Closed)
    assert reason in closed.reason


def test_a_newcomer_has_an_id_and_streams_of_its_own() -> None:
    for newcomer in (
        Peer(peer_id="p1", name="Ada"),
        Peer(peer_id="p9", name="Eve", tracks=(OWN,)),
        Peer(peer_id="p9", name="Eve", tracks=BOB.tracks),
    ):
        client = joined_client()
        (closed,) = client.receive_data(encode_message(PeerJoined(peer=newcomer)), 1.0)
        assert isinstance(closed, Closed)
        assert "twice" in closed.reason


def test_who_comes_under_the_id_of_somebody_who_is_here_takes_their_place() -> None:
    client, eve = joined_client(), replace(BOB, name="Eve")
    events = client.receive_data(encode_message(PeerJoined(peer=eve)), 1.0)
    assert events == [PeerLeft(peer_id=BOB.peer_id), PeerJoined(peer=eve)]
    assert client.peers == {BOB.peer_id: eve}
