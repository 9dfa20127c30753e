"""The admin port with TLS, on real sockets."""

from __future__ import annotations

import asyncio
import ssl
from pathlib import Path

import pytest

from helpers.certificates import write_certificate
from pica_server.admin.server import MAX_CONNECTIONS, AdminServer
from pica_server.config.relay import RelayConfig
from pica_server.relay import Relay

pytestmark = pytest.mark.call

PATIENCE_S = 20.0


def test_sockets_that_never_shake_hands_are_counted_and_others_are_answered(tmp_path: Path) -> None:
    cert = write_certificate(tmp_path)
    config = RelayConfig(
        port=0, admin_port=0, tls_cert=cert, tls_key=cert.with_suffix(".key"), avatar_store="none"
    )
    trust = ssl.create_default_context(cafile=cert)

    async def ask(port: int) -> bytes:
        reader, writer = await asyncio.open_connection("localhost", port, ssl=trust)
        writer.write(b"GET /v1/rooms HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        try:
            return await reader.read()
        finally:
            writer.close()

    async def call() -> None:
        async with asyncio.timeout(PATIENCE_S), Relay(config) as relay:
            admin = relay.admin
            assert isinstance(admin, AdminServer)
            for _ in range(20):
                assert (await ask(admin.port)).startswith(b"HTTP/1.1 200 ")
            silent = [
                await asyncio.open_connection("localhost", admin.port)
                for _ in range(MAX_CONNECTIONS + 1)
            ]
            assert await silent[-1][0].read() == b""  # one too many: it is cut at once
            assert len(admin._tasks) == MAX_CONNECTIONS
            for _, writer in silent:
                writer.close()

    asyncio.run(call())
