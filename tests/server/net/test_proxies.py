"""Whose connection it is behind proxies, and what that is used for."""

import asyncio

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from pica_protocol import SUBPROTOCOL
from pica_server.config.relay import LimitsConfig, RelayConfig
from pica_server.errors import ConfigurationError
from pica_server.net.proxies import client_of, networks
from pica_server.relay import Relay
from simnet.clock import current_network, in_virtual_time

pytestmark = pytest.mark.call

TRUSTED = networks(("10.0.0.0/8", "127.0.0.1", "fd00::/8"))


@pytest.mark.parametrize(
    ("peer", "headers", "client"),
    [
        ("192.0.2.1", [], "192.0.2.1"),
        ("192.0.2.1", ["203.0.113.9"], "192.0.2.1"),  # no proxy of ours: anybody may write that
        ("10.0.0.1", ["203.0.113.9"], "203.0.113.9"),
        ("10.0.0.1", ["198.51.100.1, 203.0.113.9"], "203.0.113.9"),
        ("10.0.0.1", ["203.0.113.9, 10.0.0.2"], "203.0.113.9"),
        ("10.0.0.1", ["203.0.113.9", "10.0.0.2"], "203.0.113.9"),
        ("10.0.0.1", ["203.0.113.9:4711"], "203.0.113.9"),
        ("10.0.0.1", ['"[2001:db8::1]:4711"'], "2001:db8::1"),
        ("fd00::1", ["2001:db8::1"], "2001:db8::1"),
        ("::ffff:10.0.0.1", ["203.0.113.9"], "203.0.113.9"),
        ("10.0.0.1", [], "10.0.0.1"),
        ("10.0.0.1", ["unknown"], "10.0.0.1"),
        ("10.0.0.1", ["203.0.113.9, <script>, 10.0.0.2"], "10.0.0.2"),
        ("10.0.0.1", ["," * 10_000], "10.0.0.1"),
        ("", ["203.0.113.9"], ""),
    ],
)
def test_the_first_on_the_way_back_who_is_no_proxy_of_ours_is_the_client(
    peer: str, headers: list[str], client: str
) -> None:
    assert client_of(peer, headers, TRUSTED) == client


@pytest.mark.parametrize("name", ["", "proxy.example.org", "10.0.0.1/8", "300.1.1.1"])
def test_what_is_no_network_is_refused(name: str) -> None:
    with pytest.raises(ConfigurationError, match=r"--trusted-proxies: .*; write addresses"):
        RelayConfig(trusted_proxies=(name,))
    with pytest.raises(ConfigurationError, match=r"--metrics-to: .*; write addresses"):
        RelayConfig(metrics_to=(name,))


async def metrics_status(host: str, forwarded: str = "") -> int:
    """Ask for the numbers from an address, and return the status of the answer."""
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[bytes] = loop.create_future()

    class Asker(asyncio.Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            header = f"X-Forwarded-For: {forwarded}\r\n" if forwarded else ""
            request = f"GET /metrics HTTP/1.1\r\nHost: relay\r\n{header}\r\n"
            assert isinstance(transport, asyncio.WriteTransport)
            transport.write(request.encode())

        def data_received(self, data: bytes) -> None:
            if not answer.done():
                answer.set_result(data)

    transport, _ = await current_network().create_connection(Asker, host, 8765)
    status = int((await answer).split()[1])
    transport.abort()
    return status


@in_virtual_time
async def test_numbers_go_to_the_networks_that_are_named_but_not_through_a_proxy() -> None:
    async with Relay(RelayConfig(metrics_to=("192.0.2.0/24",))):
        assert await metrics_status("192.0.2.9") == 200
        assert await metrics_status("127.0.0.1") == 200
        assert await metrics_status("198.51.100.1") == 403
        assert await metrics_status("192.0.2.9", forwarded="198.51.100.1") == 403
        assert await metrics_status("127.0.0.1", forwarded="127.0.0.1") == 403


async def close_code(forwarded: str | None) -> int | None:
    """Connect through a proxy that says so, and return how the relay ends it within a second."""
    headers = {} if forwarded is None else {"X-Forwarded-For": forwarded}
    async with connect(
        "ws://127.0.0.1:8765",
        subprotocols=[SUBPROTOCOL],  # type: ignore[list-item]
        proxy=None,
        compression=None,
        additional_headers=headers,
    ) as websocket:
        try:
            await websocket.recv()
            await websocket.recv()
        except ConnectionClosed:
            pass
        return websocket.close_code


def test_limits_of_an_address_are_those_of_the_client_behind_a_trusted_proxy() -> None:
    limits = LimitsConfig(connections_per_address=1)

    @in_virtual_time
    async def call(proxies: tuple[str, ...], expected: list[int]) -> None:
        config = RelayConfig(limits=limits, trusted_proxies=proxies, handshake_timeout_s=1)
        async with Relay(config) as relay:
            hub = relay.hub
            held = hub.connect(0.0, "203.0.113.9")
            codes = [await close_code(f"203.0.113.{i}") for i in (9, 10)]
            assert codes == expected
            hub.disconnect(held, 1006, "", 0.0)

    call((), [4003, 4003])  # everybody is this machine, which has no limit
    call(("127.0.0.1",), [4010, 4003])
