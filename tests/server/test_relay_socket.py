"""The short way for small messages and the library's way: the same messages, in the same order."""

import asyncio
import random

import pytest
from websockets.frames import Frame as WebsocketFrame
from websockets.frames import Opcode

from pica_protocol.errors import CloseCode
from pica_protocol.frames import Frame, encode_frame, media_message
from pica_protocol.session import Closed
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import in_virtual_time
from simnet.peers import WirePeer, peer_in_room

pytestmark = pytest.mark.call

URL = "ws://relay:8765"


def websocket_bytes(data: bytes, *, opcode: Opcode = Opcode.BINARY, fin: bool = True) -> bytes:
    return WebsocketFrame(opcode, data, fin=fin).serialize(mask=True)


def media(peer: WirePeer, number: int, num_bytes: int) -> bytes:
    frame = Frame(
        stream=peer.session.tracks[0].stream,
        sequence=number,
        captured_us=number,
        payload=bytes(num_bytes),
        is_keyframe=True,
    )
    return media_message([encode_frame(frame)])


async def send_in_pieces(peer: WirePeer, data: bytes, sizes: list[int]) -> None:
    for size in sizes:
        peer.websocket.transport.write(data[:size])
        data = data[size:]
        await asyncio.sleep(0.001)
    peer.websocket.transport.write(data)
    await asyncio.sleep(0.01)


def sequences(peer: WirePeer) -> list[int]:
    return [frame.sequence for _, frame in peer.arrivals]


@pytest.mark.parametrize("seed", range(8))
@in_virtual_time
async def test_messages_cut_anywhere_on_their_way_arrive_whole_and_in_order(seed: int) -> None:
    rng = random.Random(seed)
    async with (
        Relay(RelayConfig()),
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob") as bob,
    ):
        # Short ones and long ones, a ping between two of them.
        stream = b"".join(
            websocket_bytes(media(ada, number, rng.choice((0, 6, 108, 109, 110, 600))))
            + (websocket_bytes(b"?", opcode=Opcode.PING) if number == 5 else b"")
            for number in range(12)
        )
        await send_in_pieces(ada, stream, [rng.randrange(1, 200) for _ in range(10)])
        assert sequences(bob) == list(range(12))


@in_virtual_time
async def test_messages_sent_in_one_go_replace_each_other_nowhere() -> None:
    async with (
        Relay(RelayConfig()) as relay,
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob") as bob,
    ):
        await send_in_pieces(ada, b"".join(websocket_bytes(media(ada, n, 6)) for n in range(9)), [])
        assert sequences(bob) == list(range(9))
        assert relay.hub.stats.dropped["replaced"] == 0


@in_virtual_time
async def test_a_fragmented_message_is_overtaken_by_none_that_come_after_it() -> None:
    async with (
        Relay(RelayConfig()),
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob") as bob,
    ):
        whole = media(ada, 1, 6)
        stream = (
            websocket_bytes(media(ada, 0, 6))
            + websocket_bytes(whole[:9], fin=False)
            + websocket_bytes(whole[9:], opcode=Opcode.CONT)
            + websocket_bytes(media(ada, 2, 6))
            + websocket_bytes(media(ada, 3, 6))
        )
        await send_in_pieces(ada, stream, [40])
        assert sequences(bob) == [0, 1, 2, 3]


@in_virtual_time
async def test_a_message_after_bytes_that_are_no_websocket_is_not_taken() -> None:
    async with (
        Relay(RelayConfig()),
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob") as bob,
    ):
        unmasked = WebsocketFrame(Opcode.BINARY, media(ada, 0, 6)).serialize(mask=False)
        await send_in_pieces(ada, unmasked + websocket_bytes(media(ada, 1, 6)), [])
        assert (await ada.until(Closed)).code == 1002
        assert sequences(bob) == []


@in_virtual_time
async def test_a_message_behind_one_that_closes_the_connection_is_not_taken() -> None:
    async with (
        Relay(RelayConfig()),
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob") as bob,
    ):
        stream = websocket_bytes(b"\x02nonsense") + websocket_bytes(media(ada, 1, 6))
        await send_in_pieces(ada, stream, [])
        assert (await ada.until(Closed)).code == CloseCode.MALFORMED
        assert sequences(bob) == []
