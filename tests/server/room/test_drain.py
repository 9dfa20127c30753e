"""Sending everybody away: in which order, what they are told, and what still reaches them."""

import pytest

from helpers.members import Member
from pica_protocol.codec import decode_message
from pica_protocol.errors import CloseCode
from pica_protocol.messages import Bye, PeerJoined, PeerLeft, PeerUpdated, UpdateMetadata, Whisper
from pica_protocol.session import Closed
from pica_server.config import ConfigurationError, LimitsConfig, RelayConfig
from pica_server.relay import Relay
from pica_server.room.hub import Hub
from simnet.clock import current_network, in_virtual_time
from simnet.peers import now, peer_in_room

pytestmark = pytest.mark.call

URL = "ws://relay:8765"
ELSEWHERE = "ws://other:8765"


def guest_in(hub: Hub, room: str, now: float = 0.0) -> Member:
    return Member(hub, "guest", room=room, now=now)


def draining_hub(**limits: float) -> Hub:
    config = RelayConfig(drain_s=10, drain_to=ELSEWHERE, limits=LimitsConfig(**limits))
    return Hub(config)


def test_what_waits_for_somebody_goes_out_before_their_goodbye() -> None:
    hub = draining_hub()
    ada, bob = guest_in(hub, "tea"), guest_in(hub, "tea")
    ada.listen(0.0)
    bob.session.tell(UpdateMetadata(metadata=(("hand", "up"),)))
    bob.speak(1.0)
    bob.session.close()
    bob.speak(1.0)
    hub.drain(now=1.0)
    assert [type(message) for message in ada.listen(1.0)] == [PeerUpdated, PeerLeft, Bye]


def test_rooms_follow_one_after_the_other_and_talk_on_until_then() -> None:
    hub = draining_hub(joins_per_s=1)
    first = [guest_in(hub, "first", at) for at in (0.0, 0.0)]
    second = [guest_in(hub, "second", at) for at in (5.0, 10.0)]
    hub.drain(now=20.0)
    assert [guest.connection.closed is not None for guest in first] == [True, True]
    assert hub.num_connections == 2
    hub.handle_timer(now=21.9)
    second[0].session.tell(Whisper(peer_id=str(second[1].session.peer_id), data=b"still here"))
    second[0].speak(21.9)
    assert second[1].listen(21.9) == [
        Whisper(peer_id=str(second[0].session.peer_id), data=b"still here")
    ]
    hub.handle_timer(now=22.0)
    assert hub.num_connections == 0


def test_who_comes_while_the_relay_drains_is_told_where_to_go() -> None:
    hub = draining_hub(joins_per_s=1)
    waiting = hub.connect(0.0)
    guest_in(hub, "a", 0.0)
    guest_in(hub, "b", 5.0)
    hub.drain(now=20.0)
    late = hub.connect(20.1)
    for connection in (waiting, late):
        message = hub.take(connection, 20.1)
        assert message is not None
        assert decode_message(message.data) == Bye(
            code=1001, reason="the relay is stopping", url=ELSEWHERE
        )


@pytest.mark.parametrize("url", ["http://a", "other:8765", "ws://me:secret@a"])
def test_what_is_no_relay_is_no_place_to_send_anybody(url: str) -> None:
    with pytest.raises(ConfigurationError, match="--drain-to must be empty or ws"):
        RelayConfig(drain_to=url)


@in_virtual_time
async def test_a_drain_ends_as_soon_as_everybody_is_gone() -> None:
    async with (
        Relay(RelayConfig(drain_to=ELSEWHERE)) as relay,
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob") as bob,
    ):
        await ada.until(PeerJoined)
        start = now()
        await relay.drain()
        assert now() - start < 0.1
        for peer in (ada, bob):
            closed = await peer.until(Closed)
            assert (closed.code, closed.url) == (CloseCode.GOING_AWAY, ELSEWHERE)
            assert peer.told(PeerLeft) == []


@in_virtual_time
async def test_who_does_not_go_is_cut_at_the_end_of_the_drain() -> None:
    async with Relay(RelayConfig(drain_s=7)) as relay, peer_in_room(URL, "Ada") as ada:
        async with peer_in_room("ws://train:8765", "Bob") as bob:
            current_network().cut("train")
            start = now()
            await relay.drain()
            assert now() - start == pytest.approx(7)
            assert relay.hub.num_connections == 0
            bob.websocket.transport.abort()
        assert ada.told(Closed)
