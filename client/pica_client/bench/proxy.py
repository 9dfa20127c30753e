"""A worse network on this machine: a TCP proxy on loopback that delays the bytes of a real
connection as `impairment.Way` says, in order, losing none.

    async with ImpairedProxy(url, impairment) as proxy:
        ... connect to proxy.url instead of url ...

Towards who connects, bytes meet all of the impairment; the other way only its delay. Loss on TCP
is the delay of a retransmission: a lost segment comes 200 ms later (Linux's least timeout, doubled
with each further loss), and all behind it waits. What `read` gives at once counts as one segment.

Bounded: what has not left yet stays in a kernel buffer of about `BUFFER_BYTES` (the kernel may
round it up), so a low rate is felt by who sends; what is under way is at most `MAX_UNDER_WAY`
segments.

Unrealistic: what `impairment` says of its model; the kernel's own TCP on loopback sees a perfect
way with a slow reader, so its congestion control and its round trip times are not those of such a
network.
"""

import asyncio
import contextlib
import socket
from typing import Self
from urllib.parse import urlsplit

import numpy as np

from pica_client.bench.impairment import Impairment, Way
from pica_client.stats import TCP_IP_HEADER_BYTES

SEGMENT_BYTES = 1448
"""Payload of a TCP segment on Ethernet."""
BUFFER_BYTES = 1024
"""Of the sockets towards who sends (chosen: as small as the kernel lets it be, so that what a low
rate piles up is the sender's own doing. With 4096 and 1448 a call of two peers at 64 kbit/s was
1.6 s behind, with this 0.6 s). A real bottleneck may well hold more."""
READ_AHEAD_BYTES = 256
"""Read from the kernel before what was read has left (the same reason)."""
MAX_UNDER_WAY = 1024
"""Segments between both ends; then nothing more is read."""
CONNECT_TIMEOUT_S = 5.0

_Segments = asyncio.Queue[tuple[float, bytes]]


class ImpairedProxy:
    """Listens on a free loopback port for connections to one server.

    Attributes:
        url: Where to connect; as the server's, but for host and port.
    """

    def __init__(self, url: str, impairment: Impairment) -> None:
        """Prepare.

        Args:
            url: Of the server, ws://HOST:PORT.
            impairment: What the way from the server to us is like.
        """
        parts = urlsplit(url)
        if parts.scheme != "ws" or parts.hostname is None:
            raise ValueError(f"url is {url!r}; ws://HOST:PORT is needed")
        self.url = url
        self._server_address = (parts.hostname, parts.port or 80)
        self._impairment = impairment
        self._rng = np.random.default_rng(0)  # times are real: runs are alike, and not the same
        self._listener: asyncio.Server | None = None
        self._connections: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Self:
        self._listener = await asyncio.start_server(
            self._accept, "127.0.0.1", 0, limit=READ_AHEAD_BYTES
        )
        port = self._listener.sockets[0].getsockname()[1]
        self.url = urlsplit(self.url)._replace(netloc=f"127.0.0.1:{port}").geturl()
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._listener is not None:
            self._listener.close()
        for task in self._connections:
            task.cancel()
        await asyncio.gather(*self._connections, return_exceptions=True)

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.create_task(self._serve(reader, writer), name="impaired connection")
        self._connections.add(task)
        task.add_done_callback(self._connections.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Join two connections until both directions have ended, or one breaks."""
        server: asyncio.StreamWriter | None = None
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT_S):
                from_server, server = await self._connect()
            back = Impairment(delay_s=self._impairment.delay_s)
            async with asyncio.TaskGroup() as pumps:
                pumps.create_task(_pump(from_server, writer, Way(self._impairment, self._rng)))
                pumps.create_task(_pump(reader, server, Way(back, self._rng)))
        except* OSError:
            pass  # one end is gone; both are cut below, as a broken network does
        finally:
            for end in (writer, server):
                if end is not None:
                    end.transport.abort()

    async def _connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        loop = asyncio.get_running_loop()
        family, kind, protocol, _, address = (
            await loop.getaddrinfo(*self._server_address, type=socket.SOCK_STREAM)
        )[0]
        end = socket.socket(family, kind, protocol)
        try:
            # Before connecting: the window that is offered to the server follows from it.
            end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            end.setblocking(False)
            await loop.sock_connect(end, address)
            return await asyncio.open_connection(sock=end, limit=READ_AHEAD_BYTES)
        except BaseException:
            end.close()
            raise


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, way: Way) -> None:
    """Carry bytes one way until their end, then pass the end on."""
    segments: _Segments = asyncio.Queue(MAX_UNDER_WAY)
    async with asyncio.TaskGroup() as halves:
        halves.create_task(_depart(reader, segments, way))
        halves.create_task(_arrive(segments, writer))


async def _depart(reader: asyncio.StreamReader, segments: _Segments, way: Way) -> None:
    loop = asyncio.get_running_loop()
    while data := await reader.read(SEGMENT_BYTES):
        arrival_s = way.transmit(len(data) + TCP_IP_HEADER_BYTES, loop.time())
        await segments.put((arrival_s, data))
        await asyncio.sleep(max(way.free_s - loop.time(), 0.0))
    await segments.put((0.0, b""))


async def _arrive(segments: _Segments, writer: asyncio.StreamWriter) -> None:
    loop = asyncio.get_running_loop()
    while True:
        arrival_s, data = await segments.get()
        if not data:
            break
        await asyncio.sleep(max(arrival_s - loop.time(), 0.0))
        writer.write(data)
        await writer.drain()
    with contextlib.suppress(OSError):
        writer.write_eof()
