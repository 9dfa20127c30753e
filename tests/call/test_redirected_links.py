"""Links that a relay redirects, on the virtual clock: by a drain, or as the answer to a join."""

import asyncio

import pytest
from websockets.asyncio.server import ServerConnection, serve
from websockets.typing import Subprotocol

from pica_client.transport.connect import LinkConfig
from pica_client.transport.link import Link
from pica_protocol import SUBPROTOCOL
from pica_protocol.errors import CloseCode
from pica_protocol.messages import Joined
from pica_protocol.session import ClientEvent, ServerSession, State
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import in_virtual_time

pytestmark = pytest.mark.call

URL = "ws://relay:8765"


def make_link(
    connect_timeout_s: float | None = 3.0, redirect_hosts: tuple[str, ...] = ()
) -> tuple[Link, asyncio.Event]:
    """A link, and what is set when it has joined."""
    joined = asyncio.Event()

    def take(event: ClientEvent, _now: float) -> None:
        if isinstance(event, Joined):
            joined.set()

    config = LinkConfig(
        url=URL,
        room="r",
        connect_timeout_s=connect_timeout_s,
        redirect_hosts=redirect_hosts,
    )
    return Link(config, on_event=take), joined


@in_virtual_time
async def test_a_link_goes_where_a_relay_sends_it_without_waiting() -> None:
    loop = asyncio.get_running_loop()
    config = RelayConfig(drain_to="ws://relay:8766")
    async with Relay(RelayConfig(port=8766)) as other, Relay(config) as relay:
        link, joined = make_link()
        running = asyncio.create_task(link.run())
        await joined.wait()
        await asyncio.sleep(10)
        joined.clear()
        start = loop.time()
        await relay.drain()
        await joined.wait()
        assert loop.time() - start < 0.1
        assert link.url == "ws://relay:8766"
        assert other.hub.num_rooms == 1
        link.leave()
        await running


@in_virtual_time
async def test_a_link_does_not_go_to_a_host_that_it_does_not_know() -> None:
    link, joined = make_link()
    async with Relay(RelayConfig(port=8766)) as other:
        async with Relay(RelayConfig(drain_to="ws://other:8766")) as relay:
            running = asyncio.create_task(link.run())
            await joined.wait()
            await asyncio.sleep(10)
            await relay.drain()
        joined.clear()
        async with Relay(RelayConfig()):
            await joined.wait()
            assert link.url == URL
            assert other.hub.stats.connections == 0
            link.leave()
            await running


@in_virtual_time
async def test_a_link_that_is_sent_to_nobody_comes_back() -> None:
    config = RelayConfig(drain_to="ws://relay:9999")
    link, joined = make_link()
    async with Relay(config) as relay:
        running = asyncio.create_task(link.run())
        await joined.wait()
        await asyncio.sleep(10)
        await relay.drain()
    joined.clear()
    async with Relay(RelayConfig()):
        await joined.wait()
        assert link.url == URL
        link.leave()
        await running


async def send_away(websocket: ServerConnection, url: str, *, joins: bool) -> None:
    """Be a relay that has not the room, or lets in and sends away at once."""
    loop = asyncio.get_running_loop()
    session = ServerSession(now=loop.time())
    while session.state is not State.DECIDING:
        session.receive_data(await websocket.recv(), loop.time())
    if joins:
        session.accept(Joined(room="r", peer_id="p1"))
    session.close(CloseCode.GOING_AWAY, "not here", url)
    for data in session.messages_to_send(loop.time()):
        await websocket.send(data)
    await websocket.close(CloseCode.GOING_AWAY)


PICA = [Subprotocol(SUBPROTOCOL)]


@in_virtual_time
async def test_a_link_that_joins_goes_at_once_to_the_relay_that_has_its_room() -> None:
    async def answer(websocket: ServerConnection) -> None:
        await send_away(websocket, "ws://other:8766", joins=False)

    loop = asyncio.get_running_loop()
    async with (
        Relay(RelayConfig(port=8766)),
        serve(answer, "relay", 8765, subprotocols=PICA, compression=None),
    ):
        link, joined = make_link(redirect_hosts=("other",))
        start = loop.time()
        running = asyncio.create_task(link.run())
        await joined.wait()
        assert loop.time() - start < 0.1
        assert link.url == "ws://other:8766"
        assert link.reconnects == 0
        link.leave()
        await running


@pytest.mark.parametrize("joins", [False, True])
@in_virtual_time
async def test_relays_that_send_a_link_to_and_fro_make_it_slower(joins: bool) -> None:
    welcomes: list[float] = []

    async def answer(websocket: ServerConnection) -> None:
        welcomes.append(asyncio.get_running_loop().time())
        await send_away(websocket, "ws://relay:8765", joins=joins)

    async with serve(answer, "relay", 8765, subprotocols=PICA, compression=None):
        link, _ = make_link(connect_timeout_s=None)
        running = asyncio.create_task(link.run())
        await asyncio.sleep(120)
        link.leave()
        await running
    assert 10 < len(welcomes) < 40
