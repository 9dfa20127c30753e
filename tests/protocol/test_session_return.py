"""A client that comes back, and what the others say of themselves meanwhile."""

from dataclasses import replace

import pytest

from pica_protocol.client_session import ClientSession, Ticket
from pica_protocol.codec import encode_message
from pica_protocol.errors import CloseCode
from pica_protocol.frames import decode_media
from pica_protocol.messages import (
    Join,
    Joined,
    Peer,
    PeerAway,
    PeerBack,
    PeerJoined,
    PeerUpdated,
    StreamMuted,
    Track,
)

pytestmark = pytest.mark.unit

FACE = Track(kind="face")


def client_with(ticket: Ticket | None = None, *, resumed: bool = False) -> ClientSession:
    client = ClientSession(room="r", name="Ada", tracks=(FACE,), now=0.0, ticket=ticket)
    own = (replace(FACE, stream=1),)
    joined = Joined(room="r", peer_id="p1", tracks=own, resume="s3cret", resumed=resumed)
    client.receive_data(encode_message(joined), now=0.0)
    return client


def test_a_client_that_comes_back_goes_on_counting_where_it_stopped() -> None:
    client = client_with()
    for _ in range(3):
        client.send_frame(b"x", captured_us=0)
        client.messages_to_send(now=0.0)
    ticket = client.ticket
    assert ticket == Ticket(secret="s3cret", next_sequences=(3,))
    again = client_with(ticket, resumed=True)
    again.messages_to_send(now=0.0)
    again.send_frame(b"x", captured_us=0)
    assert decode_media(again.messages_to_send(now=0.0)[0])[0].sequence == 3


def test_a_client_whose_place_is_gone_begins_to_count_anew() -> None:
    again = client_with(Ticket(secret="old", next_sequences=(500,)), resumed=False)
    again.messages_to_send(now=0.0)
    again.send_frame(b"x", captured_us=0)
    assert decode_media(again.messages_to_send(now=0.0)[0])[0].sequence == 0


def test_a_client_that_did_not_ask_to_come_back_refuses_to_be_resumed() -> None:
    client = client_with(resumed=True)
    assert client.closed is not None
    assert client.closed.code == CloseCode.MALFORMED


def test_secrets_to_come_back_with_are_not_shown_when_printed() -> None:
    client = client_with()
    shown = repr(client.ticket) + repr(Joined(room="r", peer_id="p", resume="s3cret"))
    assert "s3cret" not in shown + repr(Join(room="r", name="n", resume="s3cret"))


def test_a_client_knows_who_is_away_and_what_the_others_say_of_themselves() -> None:
    client = client_with()
    for message in (
        PeerJoined(peer=Peer(peer_id="p2", name="Bob")),
        PeerAway(peer_id="p2"),
        PeerUpdated(peer_id="p2", metadata=(("hand", "up"),)),
    ):
        assert client.receive_data(encode_message(message), now=0.0) == [message]
    assert client.away == {"p2"}
    assert client.peers["p2"].metadata == (("hand", "up"),)
    client.receive_data(encode_message(PeerBack(peer_id="p2")), now=0.0)
    assert client.away == set()


def test_frames_of_a_muted_stream_stay_here_and_leave_a_hole_in_the_sequence() -> None:
    client = client_with()
    client.messages_to_send(now=0.0)
    sent: list[int] = []
    for is_muted in (False, True, False):
        client.receive_data(encode_message(StreamMuted(stream=1, is_muted=is_muted)), now=0.0)
        client.send_frame(b"x", captured_us=0)
        for message in client.messages_to_send(now=0.0):
            sent += [frame.sequence for frame in decode_media(message)]
    assert sent == [0, 2]
    assert client.drops == {"muted": 1}
