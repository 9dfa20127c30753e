"""Whose connection it is behind proxies, and what that is used for."""

import asyncio

import pytest
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

from pica_protocol import SUBPROTOCOL
from pica_server.config import ConfigurationError, RelayConfig
from pica_server.limits import address_group, client_of, networks
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


async def http_status(
    host: str, header: str = "", *, path: str = "/metrics", asked: str = "127.0.0.1:8765"
) -> int:
    """Ask a host for a page from an address; return the status of the answer."""
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[bytes] = loop.create_future()

    class Asker(asyncio.Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            lines = [f"GET {path} HTTP/1.1", f"Host: {asked}", *filter(None, [header]), "", ""]
            assert isinstance(transport, asyncio.WriteTransport)
            transport.write("\r\n".join(lines).encode())

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
        assert await http_status("192.0.2.9") == 200
        assert await http_status("127.0.0.1") == 200
        assert await http_status("198.51.100.1") == 403
        for header in ("X-Forwarded-For: 127.0.0.1", "Forwarded: for=127.0.0.1", "Via: 1.1 edge"):
            assert await http_status("192.0.2.9", header) == 403
            assert await http_status("127.0.0.1", header) == 403
        assert await http_status("127.0.0.1", "x-real-ip: 198.51.100.1") == 403


REBOUND = "evil.example:8765"
"""A name that somebody has made to point at whoever looks at their page."""


@in_virtual_time
async def test_no_page_whose_name_was_made_to_point_here_reads_what_is_for_this_machine() -> None:
    pages = ("/metrics", "/healthz", "/readyz", "/avatars/" + 64 * "0")
    async with Relay(RelayConfig(avatar_store="none")):
        for path in pages:
            for asked in ("127.0.0.1:8765", "localhost", "[::1]:8765"):
                assert await http_status("127.0.0.1", path=path, asked=asked) in (200, 501)
            for asked in (REBOUND, "127.0.0.1.evil.example", "localhost@evil.example", "[", ""):
                header = "X-Forwarded-For: 127.0.0.1"  # a page may add this to its request
                assert await http_status("127.0.0.1", path=path, asked=asked) in (400, 403)
                assert await http_status("127.0.0.1", header, path=path, asked=asked) in (400, 403)
    async with Relay(RelayConfig(avatar_store="none", trusted_proxies=("127.0.0.1",))):
        header = "X-Forwarded-For: 192.0.2.9"
        found = [await http_status("127.0.0.1", header, path=p, asked=REBOUND) for p in pages]
        assert found == [403, 200, 200, 501], "a proxy of ours may ask for what it likes"


@in_virtual_time
async def test_a_relay_for_others_tells_them_that_it_lives_and_a_page_here_no_numbers() -> None:
    async with Relay(RelayConfig(host="0.0.0.0", insecure=True)):
        for path, status in (("/metrics", 403), ("/healthz", 200)):
            assert await http_status("127.0.0.1", path=path, asked=REBOUND) == status


@pytest.mark.parametrize(("proxies", "address"), [((), ""), (("127.0.0.1",), "203.0.113.9")])
@in_virtual_time
async def test_a_connection_belongs_to_the_client_behind_a_trusted_proxy(
    proxies: tuple[str, ...], address: str
) -> None:
    async with (
        Relay(RelayConfig(trusted_proxies=proxies)) as relay,
        connect(
            "ws://127.0.0.1:8765",
            subprotocols=[Subprotocol(SUBPROTOCOL)],
            proxy=None,
            additional_headers={"X-Forwarded-For": "203.0.113.9"},
        ),
    ):
        (connection,) = relay.hub.connections.open
        assert connection.address == address


@pytest.mark.parametrize(
    ("host", "group"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "20010db800010002"),
        ("2001:db8:1:2::", "20010db800010002"),
        ("fe80::1%eth0", "fe80000000000000"),
        ("127.0.0.1", ""),
        ("::1", ""),
        ("::ffff:127.0.0.1", ""),
        ("a name", ""),
    ],
)
def test_what_counts_as_one_address(host: str, group: str) -> None:
    assert address_group(host) == group
