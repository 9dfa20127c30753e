"""The proxy carries every byte, later, and ends when it is told to. Real sockets on loopback."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from urllib.parse import urlsplit

import pytest

from pica_client.bench.impairment import Impairment
from pica_client.bench.proxy import ImpairedProxy

pytestmark = pytest.mark.realtime

Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


async def through(
    impairment: Impairment,
    handler: Handler,
    use: Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]],
) -> None:
    """Run a server behind the proxy and a client before it."""
    is_done = asyncio.Event()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            await handler(reader, writer)
        writer.close()
        is_done.set()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    try:
        async with ImpairedProxy(f"ws://127.0.0.1:{port}/x", impairment) as proxy:
            parts = urlsplit(proxy.url)
            assert parts.path == "/x"
            assert parts.port != port
            reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
            try:
                await use(reader, writer)
            finally:
                writer.close()
        async with asyncio.timeout(5):
            await is_done.wait()  # the proxy has cut the server's connection too
    finally:
        server.close()
    assert not asyncio.all_tasks() - {asyncio.current_task()}


async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(1000):
        writer.write(data)


def test_every_byte_comes_in_order_and_later() -> None:
    loop_delay_s = 0.02
    impairment = Impairment(
        delay_s=loop_delay_s, jitter_s=0.01, loss_ratio=0.05, stall_s=0.05, stall_interval_s=0.2
    )
    sent = bytes(range(256)) * 200

    async def use(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        begin_s = asyncio.get_running_loop().time()
        writer.write(sent)
        writer.write_eof()
        assert await reader.read(1) == sent[:1]
        assert asyncio.get_running_loop().time() - begin_s >= 2 * loop_delay_s - 0.001
        assert await reader.read(-1) == sent[1:]

    asyncio.run(through(impairment, echo, use))
