"""A relay as one would write it first, to compare with: read a message, ``broadcast`` it.

``python tests/rivals/naive.py`` uses the same websockets library and the same protocol,
so that the same load can join, and nothing else: no queue of its own, no drop rule, no limits, no
shared messages. A receiver that does not read makes it
grow. It is no server to run.
"""

import asyncio
import os
import sys
from collections import defaultdict
from dataclasses import replace

from websockets.asyncio.server import ServerConnection, broadcast, serve
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from pica_protocol import SUBPROTOCOL
from pica_protocol.frames import MEDIA_KIND
from pica_protocol.messages import Join, Joined
from pica_protocol.session import ServerSession


class NaiveRelay:
    """Rooms are sets of websockets."""

    def __init__(self) -> None:
        self._rooms: dict[str, set[ServerConnection]] = defaultdict(set)
        self._streams = 0

    async def serve(self, websocket: ServerConnection) -> None:
        """Serve one websocket until it ends."""
        loop = asyncio.get_running_loop()
        session = ServerSession(now=loop.time())
        room: set[ServerConnection] = set()
        try:
            async for data in websocket:
                if isinstance(data, bytes) and data[:1] == bytes((MEDIA_KIND,)):
                    broadcast(room - {websocket}, data)
                    continue
                for event in session.receive_data(data, loop.time()):
                    if isinstance(event, Join):
                        room = self._rooms[event.room]
                        room.add(websocket)
                        session.accept(self._joined(event))
                for message in session.messages_to_send(loop.time()):
                    await websocket.send(message)
        except ConnectionClosed:
            pass
        finally:
            room.discard(websocket)

    def _joined(self, join: Join) -> Joined:
        self._streams += 1
        stream = self._streams % 65_535 + 1
        tracks = tuple(replace(track, stream=stream) for track in join.tracks)
        return Joined(room=join.room, peer_id=f"p{self._streams}", tracks=tracks)


async def run() -> None:
    """Listen until standard input ends."""
    loop = asyncio.get_running_loop()
    over = asyncio.Event()

    def on_input() -> None:
        if not os.read(sys.stdin.fileno(), 4096):
            over.set()

    loop.add_reader(sys.stdin.fileno(), on_input)
    relay = NaiveRelay()
    server = await serve(
        relay.serve,
        "127.0.0.1",
        0,
        subprotocols=[Subprotocol(SUBPROTOCOL)],
        compression=None,
        ping_interval=None,
    )
    print(f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}", flush=True)
    await over.wait()
    os._exit(0)  # thousands of goodbyes are of no interest to a benchmark


def main() -> None:
    """Run on the standard loop."""
    asyncio.run(run())


if __name__ == "__main__":
    main()
