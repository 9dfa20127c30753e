"""Real sockets: those that a relay listens on, and what is left in memory of lost ones."""

import asyncio
import gc
import socket

import pytest

from pica_client.transport.connect import open_websocket
from pica_protocol import SUBPROTOCOL
from pica_server.config import RelayConfig
from pica_server.net.socket import RelaySocket
from pica_server.relay import Relay

pytestmark = pytest.mark.realtime

UPGRADE = (
    b"GET / HTTP/1.1\r\nHost: relay\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
)


def num_sockets() -> int:
    """How many of a relay's sockets are in memory, in use or not."""
    return sum(type(each) is RelaySocket for each in gc.get_objects())


async def until_num_sockets(number: int) -> None:
    for _ in range(200):
        if num_sockets() == number:
            return
        await asyncio.sleep(0.01)
    raise AssertionError(f"{num_sockets()} sockets stay in memory, not {number}")


@pytest.mark.parametrize(
    "said",
    [
        b"",
        b"nonsense\r\n\r\n",
        b"GET /healthz HTTP/1.1\r\nHost: relay\r\n\r\n",
        UPGRADE + b"\r\n",  # no sub-protocol: it is told so, and closed
        UPGRADE + b"Sec-WebSocket-Protocol: pica.2\r\n\r\n",
        UPGRADE + b"Sec-WebSocket-Protocol: pica.2\r\n\r\n" + b"\x7f no frame",
        UPGRADE + b"Sec-WebSocket-Protocol: pica.store.1\r\n\r\n",
    ],
    ids=["silent", "nonsense", "page", "stranger", "guest", "rule-breaker", "giver"],
)
def test_a_lost_connection_leaves_nothing_to_the_garbage_collector(said: bytes) -> None:
    async def come_and_go() -> None:
        async with Relay(RelayConfig(port=0)) as relay:
            host, _, port = relay.url.removeprefix("ws://").rpartition(":")
            gc.collect()
            num_before = num_sockets()
            gc.disable()
            try:
                for _ in range(3):
                    reader, writer = await asyncio.open_connection(host, int(port))
                    await until_num_sockets(num_before + 1)
                    writer.write(said)
                    if said:
                        await reader.read(1)
                    writer.transport.abort()
                    await until_num_sockets(num_before)
            finally:
                gc.enable()

    asyncio.run(come_and_go())


@pytest.mark.parametrize("asked", ["GET /healthz/", "HEAD /healthz", "GET /readyz?from=probe"])
@pytest.mark.parametrize("version", ["1.0", "1.1"])
@pytest.mark.asyncio
async def test_probes_of_all_kinds_are_answered(asked: str, version: str) -> None:
    async with Relay(RelayConfig(port=0)) as relay:
        host, _, port = relay.url.removeprefix("ws://").rpartition(":")
        reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(f"{asked} HTTP/{version}\r\nHost: localhost\r\n\r\n".encode())
        head, _, body = (await reader.read()).partition(b"\r\n\r\n")
        writer.close()
    assert head.split()[1] == b"200"
    assert body == (b"" if asked.startswith("HEAD") else b"ok\n")


def test_a_zone_is_understood_and_a_silent_first_address_keeps_from_no_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def scenario() -> None:
        loop = asyncio.get_running_loop()
        connect = loop.sock_connect

        async def connect_or_wait(sock: socket.socket, address: tuple[str, int]) -> None:
            if address[0] == "127.0.0.2":
                await asyncio.sleep(60)
            await connect(sock, address)

        async def look_up(host: str, port: int, **_: object) -> list[object]:
            assert host == "fe80::1%eth0"
            found = [(each, port) for each in ("127.0.0.2", "127.0.0.1")]
            return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", each) for each in found]

        async with Relay(RelayConfig(port=0)) as relay, asyncio.timeout(30):
            monkeypatch.setattr(loop, "sock_connect", connect_or_wait)
            monkeypatch.setattr(loop, "getaddrinfo", look_up)
            port = relay.url.rpartition(":")[2]
            async with await open_websocket(f"ws://[fe80::1%25eth0]:{port}") as websocket:
                assert websocket.subprotocol == SUBPROTOCOL

    monkeypatch.setenv("no_proxy", "*")
    asyncio.run(scenario())


@pytest.mark.skipif(not socket.has_dualstack_ipv6(), reason="no IPv6")
@pytest.mark.asyncio
async def test_two_colons_listen_for_both_families_and_zones() -> None:
    zone = socket.if_nametoindex("lo")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    async with Relay(RelayConfig(host="::", port=port, insecure=True)):
        for host in ("127.0.0.1", "[::1]", f"[::1%{zone}]", f"[::1%25{zone}]"):
            async with await open_websocket(f"ws://{host}:{port}") as websocket:
                assert websocket.subprotocol == SUBPROTOCOL
