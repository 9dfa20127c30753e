"""The smallest client that is one: the real session on a real websocket, and what came.

For tests of the relay; the product's own clients are tested where they live.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import TypeVar

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from pica_protocol import SUBPROTOCOL
from pica_protocol.client_session import ClientSession
from pica_protocol.frames import Frame
from pica_protocol.messages import Track
from pica_protocol.session import ClientEvent, State

E = TypeVar("E")

FACE = Track(kind="face", avatar="ab" * 32)


class WirePeer:
    """One member of a room, by a real session on a real websocket; `arrivals` are the frames among
    its `events`, each with when it came."""

    def __init__(self, websocket: ClientConnection, session: ClientSession) -> None:
        self.websocket = websocket
        self.session = session
        self.events: list[ClientEvent] = []
        self.arrivals: list[tuple[float, Frame]] = []
        self.news = asyncio.Condition()

    async def read(self) -> None:
        """Read until the websocket ends."""
        try:
            while True:
                await self._note(self.session.receive_data(await self.websocket.recv(), now()))
                await self.flush()
        except ConnectionClosed:
            code, reason = self.websocket.close_code or 1006, self.websocket.close_reason or ""
            await self._note(self.session.receive_close(code, reason, now()))

    async def flush(self) -> None:
        """Send what the session has to say; that nobody listens any more is the reader's news."""
        with suppress(ConnectionClosed):
            for data in self.session.messages_to_send(now()):
                await self.websocket.send(data)

    async def send_frame(self, payload: bytes, *, track: int = 0) -> None:
        """Publish a frame that was captured now, by the clock of the loop."""
        captured_us = round(now() * 1e6)
        self.session.send_frame(payload, captured_us, track=track)
        await self.flush()

    async def publish(self, num_frames: int, fps: float, num_bytes: int = 100) -> None:
        """Publish at a steady rate."""
        start = now()
        for i in range(num_frames):
            await asyncio.sleep(start + i / fps - now())
            await self.send_frame(bytes(num_bytes))

    async def until(self, kind: type[E]) -> E:
        """Wait for the first event of a kind, and return it."""
        async with self.news:
            await self.news.wait_for(lambda: any(isinstance(e, kind) for e in self.events))
        return next(event for event in self.events if isinstance(event, kind))

    def told(self, kind: type[E]) -> list[E]:
        """Return the events of a kind that have come so far."""
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def delays_s(self) -> list[float]:
        """Capture to arrival of each frame; all peers of a virtual call share one clock."""
        return [arrived_s - frame.captured_us / 1e6 for arrived_s, frame in self.arrivals]

    async def _note(self, events: list[ClientEvent]) -> None:
        async with self.news:
            self.events += events
            self.arrivals += [(now(), event) for event in events if isinstance(event, Frame)]
            self.news.notify_all()


@asynccontextmanager
async def open_websocket(url: str) -> AsyncIterator[ClientConnection]:
    """Connect without saying anything."""
    async with connect(
        url,
        subprotocols=[SUBPROTOCOL],  # type: ignore[list-item]
        proxy=None,
        compression=None,
        close_timeout=1,
        ping_interval=None,
    ) as websocket:
        yield websocket


@asynccontextmanager
async def peer_in_room(
    url: str,
    name: str,
    *,
    room: str = "lobby",
    tracks: tuple[Track, ...] = (FACE,),
    token: str = "",
) -> AsyncIterator[WirePeer]:
    """Join a room, read whatever comes, and leave in good order unless it is over before."""
    async with open_websocket(url) as websocket:
        session = ClientSession(room=room, name=name, tracks=tracks, token=token, now=now())
        peer = WirePeer(websocket, session)
        await peer.flush()
        reader = asyncio.create_task(peer.read())
        try:
            async with peer.news:
                await peer.news.wait_for(lambda: bool(peer.events))
            yield peer
        finally:
            if peer.session.state is State.JOINED:
                peer.session.close()
                await peer.flush()
                await peer.websocket.close()
            reader.cancel()
            await asyncio.gather(reader, return_exceptions=True)


def now() -> float:
    """The loop's clock."""
    return asyncio.get_running_loop().time()
