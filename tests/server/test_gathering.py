"""Faces that gather in a relay with much to do: real websockets on a virtual clock."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from helpers.members import VOICE
from pica_protocol.frames import Frame, encode_frame, media_message
from pica_protocol.messages import Join, KeyframeRequest, PeerLeft
from pica_server.auth.tokens import Admission
from pica_server.config.relay import RelayConfig
from pica_server.relay import Relay
from pica_server.room.brake import GATHER_S, GATHER_SURE_S
from pica_server.room.forwarding import Forwarding
from pica_server.room.room import Room
from simnet.clock import in_virtual_time
from simnet.peers import FACE, WirePeer, now, peer_in_room

pytestmark = pytest.mark.call

URL = "ws://relay:8765"
AT_ONCE_S = 0.002
BOTH = (FACE, VOICE)


@asynccontextmanager
async def busy_relay(config: RelayConfig | None = None) -> AsyncIterator[Relay]:
    """A relay that will let faces gather for a second."""
    async with Relay(config or RelayConfig()) as relay:
        for seconds in (0.0, GATHER_SURE_S):
            relay.hub.brake.note_turn(0.0, 1.0, now() + seconds)
        assert relay.hub.brake.is_gathering
        yield relay


async def gathering_begins(sender: WirePeer, *others: WirePeer) -> None:
    """Wait until what has gathered in a room has just left, and forget it."""
    await sender.send_frame(b"first")
    await others[0].until(Frame)
    await asyncio.sleep(AT_ONCE_S / 2)
    for peer in others:
        peer.arrivals.clear()


def payloads(peer: WirePeer) -> list[bytes]:
    return [frame.payload for _, frame in peer.arrivals]


@in_virtual_time
async def test_faces_of_a_room_wait_for_each_other_and_share_messages() -> None:
    async with (
        busy_relay() as relay,
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob") as bob,
        peer_in_room(URL, "Cyd") as cyd,
        peer_in_room(URL, "Dot", room="elsewhere") as dot,
        peer_in_room(URL, "Eve", room="elsewhere") as eve,
    ):
        await gathering_begins(ada, bob, cyd)
        stats, begin_s = relay.hub.stats, now()
        before = stats.messages_out
        for name, peer in ((b"a", ada), (b"b", bob), (b"c", cyd), (b"d", dot)):
            await peer.send_frame(name)
            await asyncio.sleep(GATHER_S / 5)
        assert payloads(ada) == payloads(cyd) == []
        await asyncio.sleep(begin_s + GATHER_S + AT_ONCE_S - now())
        assert payloads(ada) == [b"b", b"c"]
        assert payloads(bob) == [b"a", b"c"]
        assert payloads(cyd) == [b"a", b"b"]
        await asyncio.sleep(GATHER_S)
        assert payloads(eve) == [b"d"]
        assert stats.messages_out - before == 4
        assert max(peer.delays_s[-1] for peer in (ada, bob, cyd, eve)) < GATHER_S + AT_ONCE_S


@in_virtual_time
async def test_a_voice_does_not_wait_and_takes_along_what_has_gathered() -> None:
    async with (
        busy_relay() as relay,
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob", tracks=BOTH) as bob,
        peer_in_room(URL, "Cyd") as cyd,
    ):
        await gathering_begins(ada, bob, cyd)
        before = relay.hub.stats.messages_out
        await ada.send_frame(b"face")
        await bob.send_frame(b"other face")
        await asyncio.sleep(AT_ONCE_S)
        await bob.send_frame(b"voice", track=1)
        await asyncio.sleep(AT_ONCE_S)
        assert sorted(payloads(cyd)) == [b"face", b"other face", b"voice"]
        assert max(cyd.delays_s) <= 2 * AT_ONCE_S
        assert relay.hub.stats.messages_out - before == 3  # one to each


@in_virtual_time
async def test_what_is_no_frame_does_not_overtake_faces_of_the_same_peer() -> None:
    async with busy_relay(), peer_in_room(URL, "Bob") as bob:
        async with peer_in_room(URL, "Ada") as ada:
            await ada.send_frame(b"last")
            begin_s = now()
        await bob.until(PeerLeft)
        assert now() - begin_s < GATHER_S
        kinds = [type(event) for event in bob.events if isinstance(event, Frame | PeerLeft)]
        assert kinds == [Frame, PeerLeft]


@in_virtual_time
async def test_a_request_for_a_keyframe_is_passed_on_at_once() -> None:
    async with (
        busy_relay(),
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob") as bob,
    ):
        begin_s = now()
        await bob.send_frame(b"face")
        bob.session.tell(KeyframeRequest(stream=ada.session.tracks[0].stream))
        await bob.flush()
        await ada.until(KeyframeRequest)
        assert now() - begin_s < GATHER_S / 2


@pytest.mark.parametrize("is_keyframe", [True, False])
@in_virtual_time
async def test_what_a_peer_sends_in_one_go_arrives_whole_and_in_order(is_keyframe: bool) -> None:
    async with (
        busy_relay() as relay,
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob") as bob,
    ):
        await ada.send_frame(b"key")
        for number in range(30):
            await ada.send_frame(bytes([number]), is_keyframe=is_keyframe)
        await asyncio.sleep(2 * GATHER_S)
        assert payloads(bob) == [b"key", *(bytes([number]) for number in range(30))]
        assert not relay.hub.stats.dropped


@in_virtual_time
async def test_a_message_in_fragments_does_not_overtake_what_has_gathered() -> None:
    async with (
        busy_relay(),
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob") as bob,
    ):
        await ada.send_frame(b"whole")
        frame = Frame(
            stream=ada.session.tracks[0].stream,
            sequence=1,
            captured_us=0,
            payload=b"in parts",
            is_keyframe=True,
        )
        message = media_message([encode_frame(frame)])
        await ada.websocket.send([message[:5], message[5:]])
        await asyncio.sleep(AT_ONCE_S)
        assert payloads(bob) == [b"whole", b"in parts"]


@in_virtual_time
async def test_what_has_gathered_of_who_goes_is_passed_on() -> None:
    async with busy_relay(), peer_in_room(URL, "Bob") as bob:
        async with peer_in_room(URL, "Ada") as ada:
            await gathering_begins(ada, bob)
            await ada.send_frame(b"last")
            await asyncio.sleep(AT_ONCE_S)
            await ada.websocket.close()
        await bob.until(PeerLeft)
        assert payloads(bob) == [b"last"]


@in_virtual_time
async def test_a_relay_that_is_stopped_while_faces_gather_stops_in_good_order() -> None:
    async with busy_relay(), peer_in_room(URL, "Ada") as ada, peer_in_room(URL, "Bob"):
        await ada.send_frame(b"never mind")


@pytest.mark.parametrize(
    ("streams", "may"),
    [([1], True), ([1, 1], True), ([2], False), ([1, 2], False), ([9], False), ([], False)],
)
def test_only_frames_of_faces_may_gather(streams: list[int], may: bool) -> None:
    room = Room("lobby", capacity=5)
    room.join("p1", Join(room="lobby", name="Ada", tracks=BOTH), Admission())
    frames = [
        encode_frame(Frame(stream=stream, sequence=0, captured_us=0, payload=bytes(3)))
        for stream in streams
    ]
    assert Forwarding.may_gather(room, media_message(frames)) is may


@pytest.mark.parametrize("data", [b"", b"\x81", bytes(20)])
def test_what_is_no_media_message_does_not_gather(data: bytes) -> None:
    assert not Forwarding.may_gather(Room("lobby", capacity=5), data)
