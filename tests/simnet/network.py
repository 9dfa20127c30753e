"""Where servers listen and clients connect, in memory: host names pick the route.

    network = current_network()
    network.route("train", up=Wire(rate_bps=64_000), down=Wire(delay_s=0.08, jitter_s=0.05))
    ... connect("ws://train:8765") ...

Any host name reaches the server that listens on the port; a name with a route gets its links
(``up``: from the client to the server). A route holds for connections that are made after it is
set.
"""

import asyncio
import socket
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np

from pica_client.bench.impairment import Impairment, Way
from simnet.transport import SimTransport

_FIRST_FREE_PORT = 40_000

Wire: Final = partial(Impairment, delay_s=0.0, queue_bytes=65_536)
"""A direction of a connection; ``queue_bytes`` are what the kernels at both ends hold before the
writer must wait."""
ProtocolFactory = Callable[[], asyncio.BaseProtocol]


class Network:
    """All listeners and connections of one virtual loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._routes: dict[str, tuple[Impairment, Impairment]] = {}
        self._listeners: dict[int, ProtocolFactory] = {}
        self._connections: list[tuple[str, SimTransport, SimTransport]] = []
        self._unreachable: set[str] = set()
        self._down_until_s: dict[str, float] = {}
        self._stalled_until_s: dict[str, float] = {}

    def route(
        self, host: str, *, up: Impairment | None = None, down: Impairment | None = None
    ) -> None:
        """Say what the way to the server is like for those who connect to this host name."""
        self._routes[host] = (up or Wire(), down or Wire())

    def cut(self, host: str) -> None:
        """Swallow everything on this route, in both directions, without telling anybody."""
        self._unreachable.add(host)
        self.forget(host)

    def forget(self, host: str) -> None:
        """Swallow everything on the connections that are there, without telling anybody; new ones
        get through, as after a change of address or where a NAT has lost its table."""
        for transport in self._transports(host):
            transport.cut()

    def reset(self, host: str, down_s: float = 0.0) -> None:
        """Break every connection on this route, both ends at once, and refuse new ones a while."""
        self._down_until_s[host] = self._loop.time() + down_s
        for transport in self._transports(host):
            transport.abort()

    def stall(self, host: str, seconds: float) -> None:
        """Let nothing through on this route for a while; then all of it comes, in order."""
        self._stalled_until_s[host] = until_s = self._loop.time() + seconds
        for transport in self._transports(host):
            transport.hold(until_s)

    async def create_connection(
        self, factory: ProtocolFactory, host: str = "", port: int = 0, **_options: Any
    ) -> tuple[SimTransport, asyncio.BaseProtocol]:
        """Stand in for ``loop.create_connection``."""
        up, down = self._routes.get(host, (Wire(), Wire()))
        if host in self._unreachable:
            await asyncio.get_running_loop().create_future()  # nobody answers
        stalled_s = self._stalled_until_s.get(host, 0.0) - self._loop.time()
        await asyncio.sleep(max(stalled_s, 0.0) + up.delay_s + down.delay_s)
        if self._loop.time() < self._down_until_s.get(host, 0.0):
            raise OSError(101, "Network is unreachable")
        listener = self._listeners.get(port)
        if listener is None:
            raise ConnectionRefusedError(f"nobody listens on port {port}")
        number = len(self._connections)
        client_name, server_name = (host, 50_000 + number), ("127.0.0.1", port)
        ways = [Way(each, np.random.default_rng([number, k])) for k, each in enumerate((up, down))]
        client = SimTransport(self._loop, ways[0], client_name, server_name)
        server = SimTransport(self._loop, ways[1], server_name, client_name)
        self._connections.append((host, client, server))
        protocols = factory(), listener()
        client.connect_to(server, protocols[0])
        server.connect_to(client, protocols[1])
        protocols[1].connection_made(server)
        protocols[0].connection_made(client)
        return client, protocols[0]

    def create_server(
        self, factory: ProtocolFactory, host: str | None = None, port: int = 0, **_options: Any
    ) -> "SimServer":
        """Stand in for ``loop.create_server``; port 0 takes a free one."""
        if port == 0:
            port = max(self._listeners, default=_FIRST_FREE_PORT - 1) + 1
        if port in self._listeners:
            raise OSError(98, "Address already in use")
        self._listeners[port] = factory
        return SimServer(self._loop, port, lambda: self._listeners.pop(port, None))

    def _transports(self, host: str) -> list[SimTransport]:
        return [
            end
            for name, client, server in self._connections
            if name == host
            for end in (client, server)
        ]


class SimServer(asyncio.AbstractServer):
    """A listener; closing it leaves its connections alone, as a real one does."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, port: int, remove: Callable[[], object]
    ) -> None:
        self._loop = loop
        self._remove = remove
        self._is_serving = True
        self.sockets = (_ListeningSocket(port),)

    def get_loop(self) -> asyncio.AbstractEventLoop:
        return self._loop

    def is_serving(self) -> bool:
        return self._is_serving

    def close(self) -> None:
        if self._is_serving:
            self._is_serving = False
            self._remove()

    async def start_serving(self) -> None:
        return

    async def serve_forever(self) -> None:
        await self._loop.create_future()

    async def wait_closed(self) -> None:
        return


class _ListeningSocket:
    """As much of a socket as is asked for its address."""

    family = socket.AF_INET

    def __init__(self, port: int) -> None:
        self._port = port

    def getsockname(self) -> tuple[str, int]:
        return "127.0.0.1", self._port

    def setsockopt(self, _level: int, _option: int, _value: int) -> None:
        """Ignore it: nothing piles up in a kernel here."""
