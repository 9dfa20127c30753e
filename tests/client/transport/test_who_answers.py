"""What is said of an address where something answers that is no relay."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from helpers.certificates import write_certificate
from pica_client.transport.connect import open_websocket, trouble
from pica_server.config.relay import RelayConfig
from pica_server.relay import Relay

pytestmark = pytest.mark.call


async def said_of(url: str) -> str:
    """What the dialer tells its user of a failed attempt."""
    try:
        await open_websocket(url)
    except Exception as error:
        return trouble(error, url)
    raise AssertionError("that was a relay")


@pytest.mark.parametrize(
    ("answer", "scheme", "told"),
    [
        (b"HTTP/1.0 404 File not found\r\n\r\n", "ws", "no relay: 'HTTP/1.0 404 File not found'"),
        (b"SSH-2.0-OpenSSH_9\r\n", "ws", "something answers that is no relay: 'SSH-2.0-OpenSSH_9'"),
        (b"SSH-2.0-OpenSSH_9\r\n", "wss", "something answers without TLS; write ws://"),
        (b"", "ws", "something answers and hangs up; write wss:// if it speaks TLS"),
    ],
)
def test_a_stranger_is_quoted(answer: bytes, scheme: str, told: str) -> None:
    async def main() -> str:
        async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.read(100)
            writer.write(answer)
            writer.close()

        server = await asyncio.start_server(handle, "127.0.0.1", 0)
        async with server:
            port = server.sockets[0].getsockname()[1]
            return await said_of(f"{scheme}://127.0.0.1:{port}")

    assert told in asyncio.run(main())


@pytest.mark.parametrize("speaks_tls", [False, True])
def test_a_relay_with_or_without_tls_is_met_with_the_other_scheme(
    tmp_path: Path, speaks_tls: bool
) -> None:
    cert = write_certificate(tmp_path) if speaks_tls else None
    key = cert.with_suffix(".key") if cert is not None else None

    async def main() -> str:
        config = RelayConfig(port=0, avatar_store="none", tls_cert=cert, tls_key=key)
        async with Relay(config) as relay:
            port = relay.url.rpartition(":")[2]
            return await said_of(f"{'ws' if speaks_tls else 'wss'}://127.0.0.1:{port}")

    expected = "wss:// if it speaks TLS" if speaks_tls else "write ws:// if"
    assert expected in asyncio.run(main())
