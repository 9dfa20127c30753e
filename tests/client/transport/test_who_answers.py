"""What is said of an address where something answers that is no relay."""

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from pica_client.avatars.fetch import download
from pica_client.errors import RelayRefusedError, RelayUnreachableError
from pica_client.transport.connect import LinkConfig, open_websocket, proxy_of
from pica_client.transport.link import Link

pytestmark = pytest.mark.call


@asynccontextmanager
async def answering(answer: bytes) -> AsyncIterator[tuple[int, list[bytes]]]:
    """The port of a server that answers all with that, {port} in it filled in, and what came."""
    requests: list[bytes] = []

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        requests.append(await reader.read(100))
        writer.write(answer.replace(b"{port}", b"%d" % port))
        writer.close()

    async with await asyncio.start_server(handle, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        yield port, requests


@pytest.mark.parametrize(
    ("answer", "scheme", "told"),
    [
        (b"HTTP/1.0 404 File not found\r\n\r\n", "ws", "no relay: 'HTTP/1.0 404 File not found'"),
        (b"SSH-2.0-OpenSSH_9\r\n", "ws", "something answers that is no relay: 'SSH-2.0-OpenSSH_9'"),
        (b"SSH-2.0-OpenSSH_9\r\n", "wss", "something answers without TLS; write ws://"),
        (b"", "ws", "something answers and hangs up; write wss:// if it speaks TLS"),
    ],
)
@pytest.mark.asyncio
async def test_a_stranger_is_quoted(answer: bytes, scheme: str, told: str) -> None:
    async with answering(answer) as (port, _):
        with pytest.raises(RelayUnreachableError, match=re.escape(told)):
            await open_websocket(f"{scheme}://127.0.0.1:{port}")


@pytest.mark.parametrize("target", ["/admin", "ws://localhost:{port}/", "https://example.org/"])
@pytest.mark.asyncio
async def test_a_redirect_of_http_is_not_followed(target: str) -> None:
    redirect = f"HTTP/1.1 302 Found\r\nLocation: {target}\r\n\r\n".encode()
    async with answering(redirect) as (port, requests):
        with pytest.raises(RelayRefusedError, match="answers HTTP 302, not as a relay"):
            await Link(LinkConfig(url=f"ws://127.0.0.1:{port}")).run()
    assert len(requests) == 1


@pytest.mark.parametrize(
    ("url", "proxy", "told"),
    [
        ("ws://exa..mple:8765", "", "is no websocket address"),
        ("wss://example.org", "foo", "is not to be reached by the proxy"),
        ("wss://example.org", "ftp://127.0.0.1:1", "is not to be reached by the proxy"),
    ],
)
@pytest.mark.asyncio
async def test_an_address_or_a_proxy_that_cannot_be_is_named(
    url: str, proxy: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("https_proxy", proxy)
    with pytest.raises(RelayRefusedError, match=told):
        await Link(LinkConfig(url=url)).run()


@pytest.mark.asyncio
async def test_call_and_avatar_files_take_the_same_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("http_proxy", "https_proxy", "all_proxy", "no_proxy"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.upper(), raising=False)
    assert proxy_of("ws://relay.example:8765") is None
    monkeypatch.setenv("ALL_PROXY", "socks5h://127.0.0.1:1080")
    assert proxy_of("ws://relay.example:8765") == "socks5h://127.0.0.1:1080"
    assert proxy_of("ws://127.0.0.1:8765") is None
    monkeypatch.setenv("https_proxy", "http://127.0.0.1:3128")
    monkeypatch.setenv("no_proxy", "inside.example")
    assert proxy_of("wss://relay.example") == "http://127.0.0.1:3128"
    assert proxy_of("wss://inside.example") is None
    async with answering(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n") as (
        port,
        requests,
    ):
        monkeypatch.setenv("https_proxy", f"http://127.0.0.1:{port}")
        with pytest.raises(RelayUnreachableError, match="does not have it yet"):
            await asyncio.to_thread(download, "ws://relay.example:8765", "ab" * 32)
    assert requests[0].startswith(b"GET http://relay.example:8765/avatars/abab")
