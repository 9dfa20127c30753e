"""The short way for small messages and the library's way: the same messages, in the same order."""

import asyncio
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import cast

import pytest
from websockets.asyncio.server import Server
from websockets.datastructures import Headers
from websockets.frames import Frame as WebsocketFrame
from websockets.frames import Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from pica_protocol.client_session import ClientSession
from pica_protocol.errors import CloseCode
from pica_protocol.frames import Frame, encode_frame, media_message
from pica_protocol.messages import PeerJoined, PeerLeft
from pica_protocol.session import Closed
from pica_server.config import RelayConfig
from pica_server.limits import SocketGuard
from pica_server.net.socket import RelaySocket
from pica_server.relay import Relay
from pica_server.stats import RelayStats
from simnet.clock import in_virtual_time
from simnet.peers import WirePeer, now, open_websocket, peer_in_room

pytestmark = pytest.mark.call

URL = "ws://relay:8765"


class DeadTransport(asyncio.Transport):
    """Of a socket whose other end has gone: the first write finds out, and asyncio will say so in
    the next turn of the loop."""

    def __init__(self) -> None:
        super().__init__()
        self.num_writes = 0

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.num_writes += 1

    def is_closing(self) -> bool:
        return self.num_writes > 0

    def get_write_buffer_size(self) -> int:
        return 0

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def pause_reading(self) -> None:
        pass

    def resume_reading(self) -> None:
        pass

    def abort(self) -> None:
        raise AttributeError("'NoneType' object has no attribute 'call_soon'")  # as asyncio's may


def websocket_bytes(data: bytes, *, opcode: Opcode = Opcode.BINARY, fin: bool = True) -> bytes:
    return WebsocketFrame(opcode, data, fin=fin).serialize(mask=True)


def media(number: int, num_bytes: int) -> bytes:
    """A message of the first who joins, whose stream is 1."""
    frame = Frame(stream=1, sequence=number, captured_us=number, payload=bytes(num_bytes))
    return media_message([encode_frame(frame)])


MESSAGES = [websocket_bytes(media(number, 6)) for number in range(9)]
FRAGMENTED = websocket_bytes(media(1, 6)[:9], fin=False) + websocket_bytes(
    media(1, 6)[9:], opcode=Opcode.CONT
)


@asynccontextmanager
async def ada_and_bob() -> AsyncIterator[tuple[Relay, WirePeer, WirePeer]]:
    async with (
        Relay(RelayConfig()) as relay,
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob") as bob,
    ):
        yield relay, ada, bob


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
    async with ada_and_bob() as (_, ada, bob):
        # Short ones and long ones, a ping between two of them.
        stream = b"".join(
            websocket_bytes(media(number, rng.choice((0, 6, 108, 109, 110, 600))))
            + (websocket_bytes(b"?", opcode=Opcode.PING) if number == 5 else b"")
            for number in range(12)
        )
        await send_in_pieces(ada, stream, [rng.randrange(1, 200) for _ in range(10)])
        assert sequences(bob) == list(range(12))


@in_virtual_time
async def test_bytes_that_look_like_a_frame_in_the_middle_of_one_are_none() -> None:
    async with ada_and_bob() as (_, ada, bob):
        message = media(0, 60)
        # Masked, it begins as a short binary frame would. The header comes first, and alone.
        mask = bytes([message[0] ^ 0x82, message[1] ^ 0x81, 0, 0])
        masked = bytes(byte ^ mask[i % 4] for i, byte in enumerate(message))
        header = bytes([0x82, 0x80 | len(message)]) + mask
        for cut in range(1, len(header) + 2):
            await send_in_pieces(ada, header + masked, [cut])
        assert len(sequences(bob)) == len(header) + 1
        assert ada.session.closed is None


@pytest.mark.parametrize(
    ("stream", "heard", "code"),
    [
        (b"".join(MESSAGES), list(range(9)), None),
        (MESSAGES[0] + FRAGMENTED + MESSAGES[2] + MESSAGES[3], [0, 1, 2, 3], None),
        (WebsocketFrame(Opcode.BINARY, media(0, 6)).serialize(mask=False) + MESSAGES[1], [], 1002),
        (websocket_bytes(b"\x02nonsense") + MESSAGES[1], [], CloseCode.MALFORMED),
    ],
    ids=["in one go", "fragmented", "after no websocket", "after a bad message"],
)
@in_virtual_time
async def test_messages_of_one_read_come_in_order_and_none_behind_one_that_closes(
    stream: bytes, heard: list[int], code: int | None
) -> None:
    async with ada_and_bob() as (relay, ada, bob):
        await send_in_pieces(ada, stream, [40])
        assert sequences(bob) == heard
        assert relay.hub.stats.dropped["replaced"] == 0
        assert (ada.session.closed and ada.session.closed.code) == code


@in_virtual_time
async def test_who_floods_with_pings_is_closed_although_it_reads_no_answer() -> None:
    async with ada_and_bob() as (relay, ada, bob):
        pings = websocket_bytes(b"?" * 125, opcode=Opcode.PING) * 100
        await send_in_pieces(ada, pings, [])
        assert ada.session.closed is None  # so many at once are allowed
        await send_in_pieces(ada, pings, [])
        assert (await ada.until(Closed)).code == CloseCode.TOO_FAST
        assert (await bob.until(PeerLeft)).peer_id == ada.session.peer_id
        assert relay.hub.stats.limits_hit["extra_frames"] == 1


@in_virtual_time
async def test_fragments_without_end_are_no_message_without_end() -> None:
    async with Relay(RelayConfig()), peer_in_room(URL, "Ada") as ada:
        empty = websocket_bytes(b"", opcode=Opcode.CONT, fin=False)
        await send_in_pieces(ada, websocket_bytes(b"\x02", fin=False) + empty * 100, [])
        assert (await ada.until(Closed)).code == CloseCode.TOO_FAST


@in_virtual_time
async def test_who_breaks_a_rule_and_does_not_hang_up_is_cut_off() -> None:
    async with (
        Relay(RelayConfig(close_timeout_s=1.0)),
        peer_in_room(URL, "Bob") as bob,
        open_websocket(URL) as websocket,
    ):
        session = ClientSession(room="lobby", name="Eve", now=now())
        for data in session.messages_to_send(now()):
            await websocket.send(data)
        await bob.until(PeerJoined)
        websocket.transport.pause_reading()  # it does not see the close frame, so it stays
        websocket.transport.write(b"\x7f no frame")
        begin_s = now()
        await bob.until(PeerLeft)
        assert now() - begin_s == pytest.approx(1.0, abs=0.1)


@in_virtual_time
async def test_a_request_that_grows_and_grows_is_cut_before_it_is_large() -> None:
    async with Relay(RelayConfig()) as relay:
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_connection(asyncio.Protocol, "relay", 8765)
        transport.write(b"GET / HTTP/1.1\r\n")
        for number in range(10):
            transport.write(b"X-%d: " % number + b"a" * 4000 + b"\r\n")
            await asyncio.sleep(0.01)
        assert relay.hub.stats.limits_hit["request"]
        assert transport.is_closing()


class SlowTransport(DeadTransport):
    """Of a socket whose other end reads nothing."""

    is_closed = False

    def is_closing(self) -> bool:
        return self.is_closed

    def get_write_buffer_size(self) -> int:
        return 100 * self.num_writes

    def can_write_eof(self) -> bool:
        return True

    def write_eof(self) -> None:
        raise AssertionError("asyncio would raise later, where nobody hears it")

    def close(self) -> None:
        self.is_closed = True


class QuietServer:
    """Serves nobody."""

    def __init__(self) -> None:
        self.handler_tasks: set[object] = set()

    async def handler(self, websocket: RelaySocket) -> None:
        pass


def open_relay_socket(transport: DeadTransport | None = None) -> tuple[RelaySocket, DeadTransport]:
    websocket = RelaySocket(ServerProtocol(state=State.OPEN), cast(Server, QuietServer()))
    websocket.guard = SocketGuard(handshakes=1, per_address=1, per_s=1, burst=1)
    websocket.stats, websocket.silent = RelayStats(), set()
    websocket.handshake_timeout_s = 1.0
    websocket.request = Request("/", Headers())
    transport = transport or DeadTransport()
    websocket.connection_made(transport)
    websocket.note_opened()
    return websocket, transport


@in_virtual_time
async def test_a_socket_that_has_died_is_written_to_once_and_not_for_each_message() -> None:
    websocket, transport = open_relay_socket()
    websocket.write(b"news")
    assert transport.num_writes == 1
    assert not websocket.write(b"more news")
    websocket.data_received(websocket_bytes(b"?", opcode=Opcode.PING) * 50)
    assert transport.num_writes == 1


@in_virtual_time
async def test_many_pings_at_once_are_answered_in_one_go() -> None:
    websocket, transport = open_relay_socket()
    websocket.data_received(websocket_bytes(b"?", opcode=Opcode.PING) * 50)
    assert transport.num_writes == 1


@in_virtual_time
async def test_a_socket_that_has_ended_can_be_ended_again() -> None:
    websocket, transport = open_relay_socket()
    websocket.connection_lost(None)
    with pytest.raises(AttributeError):
        transport.abort()
    websocket.transport.abort()
    assert not websocket.write(b"news")


@in_virtual_time
async def test_a_socket_that_still_has_to_send_is_closed_after_that_and_not_by_halves() -> None:
    websocket, transport = open_relay_socket(SlowTransport())
    websocket.data_received(websocket_bytes(b"", opcode=Opcode.CLOSE))
    assert transport.num_writes == 1  # the answer
    assert transport.is_closing()
