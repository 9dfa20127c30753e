import asyncio

import pytest
from websockets.asyncio.client import connect
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosedError

from simnet.clock import current_network, in_virtual_time
from simnet.network import Wire
from simnet.peers import now

pytestmark = pytest.mark.call


async def echo(websocket: ServerConnection) -> None:
    async for message in websocket:
        await websocket.send(message)


@in_virtual_time
async def test_a_websocket_round_trip_takes_both_delays() -> None:
    current_network().route("far", up=Wire(delay_s=0.03), down=Wire(delay_s=0.05))
    async with serve(echo, "127.0.0.1", 80), connect("ws://far:80", proxy=None) as websocket:
        before = now()
        await websocket.send("hello")
        assert await websocket.recv() == "hello"
        assert now() - before == pytest.approx(0.08)


@in_virtual_time
async def test_a_silent_network_is_found_out_by_pings() -> None:
    async with (
        serve(echo, "127.0.0.1", 80, ping_interval=None, close_timeout=1),
        connect("ws://there:80", proxy=None, ping_interval=20, ping_timeout=20) as websocket,
    ):
        before = now()
        current_network().cut("there")
        with pytest.raises(ConnectionClosedError):
            await websocket.recv()
        # 20 s to the ping, 20 s for the pong, 10 s for an answer to the close frame
        assert now() - before == pytest.approx(50, abs=0.01)


@in_virtual_time
async def test_a_writer_blocks_when_nobody_reads() -> None:
    async def never_read(websocket: ServerConnection) -> None:
        websocket.transport.pause_reading()
        await websocket.wait_closed()

    current_network().route("near", up=Wire(queue_bytes=4096))
    async with (
        serve(never_read, "127.0.0.1", 80, close_timeout=1),
        connect("ws://near:80", proxy=None, compression=None, write_limit=4096) as websocket,
    ):
        for _ in range(7):  # 4096 under way, and as much in the writer's own buffer
            await websocket.send(bytes(1000))
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(asyncio.gather(*map(websocket.send, [bytes(1000)] * 3)), 10)
        websocket.transport.abort()


@in_virtual_time
async def test_nobody_listening_refuses_the_connection() -> None:
    with pytest.raises(ConnectionRefusedError):
        await connect("ws://anywhere:81", proxy=None)


@in_virtual_time
async def test_an_aborted_connection_is_an_abnormal_close_at_the_other_end() -> None:
    async with serve(echo, "127.0.0.1", 80), connect("ws://here:80", proxy=None) as websocket:
        websocket.transport.abort()
        await websocket.wait_closed()
        assert websocket.close_code == 1006


@in_virtual_time
async def test_bytes_arrive_in_the_order_in_which_they_were_written() -> None:
    received = bytearray()

    class Sink(asyncio.Protocol):
        def data_received(self, data: bytes) -> None:
            received.extend(data)

    loop = asyncio.get_running_loop()
    await loop.create_server(Sink, "127.0.0.1", 80)
    transport, _ = await loop.create_connection(asyncio.Protocol, "here", 80)
    sent = bytes(i % 251 for i in range(50_000))
    transport.write(sent)
    await asyncio.sleep(0.001)
    assert received == sent
