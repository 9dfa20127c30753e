"""The way to the relay on the virtual clock: not there, not willing, not sane, gone without a word,
elsewhere: redirected by a drain, or as the answer to a join."""

import asyncio
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.server import ServerConnection, serve
from websockets.typing import Subprotocol

from pica_client.errors import OptionError, RelayRefusedError, RelayUnreachableError
from pica_client.transport.connect import LinkConfig
from pica_client.transport.link import Link
from pica_protocol import SUBPROTOCOL
from pica_protocol.errors import CloseCode
from pica_protocol.messages import Joined
from pica_protocol.session import ClientEvent, ServerSession, State
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from pica_server.tokens import Admission, load_keys, mint, new_key_line
from simnet.clock import current_network, in_virtual_time
from simnet.peers import peer_in_room

pytestmark = pytest.mark.call

URL = "ws://relay:8765"
PICA = [Subprotocol(SUBPROTOCOL)]


def make_link(connect_timeout_s: float | None = 3.0, **options: Any) -> tuple[Link, asyncio.Event]:
    """A link, and what is set when it has joined."""
    joined = asyncio.Event()

    def take(event: ClientEvent, _now: float) -> None:
        if isinstance(event, Joined):
            joined.set()

    config = LinkConfig(url=URL, room="r", connect_timeout_s=connect_timeout_s, **options)
    return Link(config, on_event=take), joined


@asynccontextmanager
async def running_link(
    connect_timeout_s: float | None = 3.0, **options: Any
) -> AsyncIterator[tuple[Link, asyncio.Event]]:
    """A link that runs and leaves at the end, and what is set when it has joined."""
    link, joined = make_link(connect_timeout_s, **options)
    running = asyncio.create_task(link.run())
    yield link, joined
    link.leave()
    await running


@in_virtual_time
async def test_a_relay_that_is_not_there_is_given_up_after_the_connect_timeout() -> None:
    loop = asyncio.get_running_loop()
    link, _ = make_link(connect_timeout_s=3.0)
    with pytest.raises(RelayUnreachableError, match=r"no relay answers at ws://relay:8765 \(tried"):
        await link.run()
    assert 1.0 < loop.time() <= 3.0


@in_virtual_time
async def test_a_relay_that_comes_late_is_found_within_a_second_of_its_coming() -> None:
    loop = asyncio.get_running_loop()
    async with running_link(connect_timeout_s=None) as (link, joined):
        await asyncio.sleep(60)
        async with Relay(RelayConfig()):
            await joined.wait()
            assert loop.time() <= 61.1
            assert link.is_joined


@in_virtual_time
async def test_leaving_ends_a_connection_attempt_that_nobody_answers() -> None:
    loop = asyncio.get_running_loop()
    current_network().cut("relay")
    async with running_link(connect_timeout_s=None):
        await asyncio.sleep(1)
    assert loop.time() == pytest.approx(1)


@in_virtual_time
async def test_who_was_in_a_room_that_is_full_now_waits_a_minute_for_a_place() -> None:
    loop = asyncio.get_running_loop()
    async with Relay(RelayConfig(room_capacity=1)):
        link, joined = make_link()
        running = asyncio.create_task(link.run())
        await joined.wait()
        current_network().reset("relay", down_s=11)  # its place is kept for 10 s
        await asyncio.sleep(10.5)
        joined.clear()
        async with peer_in_room("ws://other:8765", "Bob", room="r"):
            await asyncio.sleep(40)
        left_s = loop.time()
        await joined.wait()
        assert loop.time() - left_s <= 8
        current_network().reset("relay", down_s=11)
        await asyncio.sleep(10.5)
        async with peer_in_room("ws://other:8765", "Bob", room="r"):
            with pytest.raises(RelayRefusedError, match=r"4004\); tried to come back for 60 s"):
                await running


@in_virtual_time
async def test_two_seconds_of_wrong_keys_end_no_call(tmp_path: Path) -> None:
    right, wrong, token_file = tmp_path / "right", tmp_path / "wrong", tmp_path / "token"
    for keys in (right, wrong):
        keys.write_text(new_key_line())
    admission = Admission(identity="ada")
    token = mint(load_keys(right), "r", admission, now=1e9, lasts_s=900)
    token_file.write_text(token, encoding="utf-16")  # as PowerShell writes it
    loop = asyncio.get_running_loop()
    async with running_link(token_file=token_file) as (link, _):
        for keys, seconds in ((right, 10.0), (wrong, 2.0), (right, 10.0)):
            async with Relay(RelayConfig(keys=keys), unix_time=lambda: 1e9 + loop.time()):
                await asyncio.sleep(seconds)
                assert link.is_joined == (keys == right)
        token_file.write_text("")  # as while somebody writes it anew
        await asyncio.sleep(5)
        token_file.write_text(token)
        async with Relay(RelayConfig(keys=right), unix_time=lambda: 1e9 + loop.time()):
            await asyncio.sleep(10)
            assert link.is_joined


@in_virtual_time
async def test_garbage_from_the_other_end_is_counted_and_tried_again_with_patience() -> None:
    rng = random.Random(5)
    connections = 0

    async def babble(websocket: ServerConnection) -> None:
        nonlocal connections
        connections += 1
        await websocket.send(rng.randbytes(200))
        await websocket.wait_closed()

    async with (
        serve(babble, "relay", 8765, subprotocols=PICA, compression=None),
        running_link(connect_timeout_s=None) as (link, joined),
    ):
        await asyncio.sleep(60)
    assert link.errors >= 8
    assert connections <= 20  # one every 4 to 8 seconds once the waits have grown
    assert not joined.is_set()


@in_virtual_time
async def test_a_websocket_server_of_another_language_is_refused_by_name() -> None:
    async def chat(websocket: ServerConnection) -> None:
        await websocket.wait_closed()

    for language in (["chat"], None):  # one that wants another, one that does not care
        async with serve(chat, "relay", 8765, subprotocols=language):  # type: ignore[arg-type]
            link, _ = make_link()
            with pytest.raises(RelayRefusedError, match=r"ws://relay:8765: .* not "):
                await link.run()


@pytest.mark.parametrize("content", [b"\xff\xfd", b"two words", None])
@in_virtual_time
async def test_a_token_file_without_a_token_is_named(content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "token"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(OptionError, match=r"token-file .*token: "):
        await Link(LinkConfig(url=URL, token_file=path)).run()


@in_virtual_time
async def test_a_link_goes_where_a_relay_sends_it_without_waiting() -> None:
    loop = asyncio.get_running_loop()
    config = RelayConfig(drain_to="ws://relay:8766")
    async with (
        Relay(RelayConfig(port=8766)) as other,
        Relay(config) as relay,
        running_link() as (link, joined),
    ):
        await joined.wait()
        await asyncio.sleep(10)
        joined.clear()
        start = loop.time()
        await relay.drain()
        await joined.wait()
        assert loop.time() - start < 0.1
        assert link.url == "ws://relay:8766"
        assert other.hub.num_rooms == 1


@pytest.mark.parametrize("target", ["ws://other:8766", "ws://relay:9999"])
@in_virtual_time
async def test_a_link_that_is_sent_to_a_strange_host_or_to_no_relay_comes_back(target: str) -> None:
    async with Relay(RelayConfig(port=8766)) as other, running_link() as (link, joined):
        async with Relay(RelayConfig(drain_to=target)) as relay:
            await joined.wait()
            await asyncio.sleep(10)
            await relay.drain()
        joined.clear()
        async with Relay(RelayConfig()):
            await joined.wait()
            assert link.url == URL
            assert other.hub.stats.connections == 0


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


@pytest.mark.parametrize("joins", [False, True])
@in_virtual_time
async def test_relays_that_send_a_link_to_and_fro_make_it_slower(joins: bool) -> None:
    welcomes: list[float] = []

    async def answer(websocket: ServerConnection) -> None:
        welcomes.append(asyncio.get_running_loop().time())
        await send_away(websocket, "ws://relay:8765", joins=joins)

    async with (
        serve(answer, "relay", 8765, subprotocols=PICA, compression=None),
        running_link(connect_timeout_s=None),
    ):
        await asyncio.sleep(120)
    assert 10 < len(welcomes) < 40
