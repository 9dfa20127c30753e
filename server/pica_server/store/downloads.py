"""The way out of the avatar store: files leave by HTTP (RFC 9110), on the port of the faces.

They must not delay them. So a transfer moves 16 KiB at a time and waits for its turn after each;
all transfers together keep to a rate; and a download is never further ahead of its reader than a
small socket buffer, so that it does not fill the queue of a slow link through which a call goes
too. Transfers are limited in number, in all and for each address, and one that is slower than it
may be is cut.

A websocket library answers small things by HTTP, whole and from memory. A file is written to the
socket by hand here; the library then finds the connection closed and does nothing more.
"""

import asyncio
import logging
import socket
from collections import Counter
from dataclasses import dataclass
from email.utils import formatdate
from http import HTTPStatus
from typing import Final

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from pica_protocol.store import AVATARS_PATH, is_avatar_id
from pica_server.errors import StoreRefusalError
from pica_server.net.socket import RelaySocket, set_tcp_option
from pica_server.store.store import AvatarStore, Slots

PIECE_BYTES: Final = 16 * 2**10
"""Written at once (chosen: as a message may have; the kernel takes it in some ten microseconds)."""
READ_BYTES: Final = 256 * 2**10
"""Read at once from the store, and held for one download."""
SEND_BUFFER_BYTES: Final = 32 * 2**10
"""How far a download may be ahead of its reader, in the kernel, which may double it (chosen: a
quarter of a second of a link with 2 Mbit/s; with 50 ms there and back still 5 Mbit/s)."""

_FILE_HEADERS: Final = {
    "Cache-Control": "public, max-age=31536000, immutable",  # its name is its hash
    "Content-Type": "application/octet-stream",
    "X-Content-Type-Options": "nosniff",
}

_logger = logging.getLogger(__name__)


@dataclass(eq=False)
class Downloads:
    """Gives the files of a store, or says that there is none."""

    _store: AvatarStore | None
    """The files; None: this relay keeps none."""
    _stats: Counter[str]
    _transfers: set[RelaySocket]
    """Where sockets are as long as a file moves; the relay cuts them at its end."""
    _origins: tuple[str, ...]
    """Web pages whose scripts may read what they get."""

    def __post_init__(self) -> None:
        if self._store is not None:
            config = self._store.config
            self._slots = Slots(config.downloads, config.downloads_per_address)

    async def answer(self, websocket: RelaySocket, request: Request) -> Response:
        """Answer a request below ``/avatars/``; for ``process_request``."""
        store = self._store
        identity = request.path.removeprefix(AVATARS_PATH).partition("?")[0]
        if store is None:
            return _refusal(websocket, HTTPStatus.NOT_IMPLEMENTED, "this relay keeps no avatars")
        if request.method != "GET":
            return _refusal(websocket, HTTPStatus.METHOD_NOT_ALLOWED, "use GET", Allow="GET")
        if not is_avatar_id(identity):
            return _refusal(
                websocket, HTTPStatus.NOT_FOUND, "an avatar's id is its SHA-256, in 64 digits"
            )
        try:
            with self._slots.taken(websocket.address):
                size = await store.size(identity)
                if not size:
                    return _refusal(websocket, HTTPStatus.NOT_FOUND, "no such avatar here")
                return await self._send(store, websocket, request, identity, size)
        except StoreRefusalError:
            self._stats["downloads_refused"] += 1
            text = "too many downloads, try again"
        except OSError as error:
            self._stats["faults"] += 1
            _logger.warning("avatar store failed", extra={"error": type(error).__name__})
            text = "the store does not answer"
        return _refusal(websocket, HTTPStatus.SERVICE_UNAVAILABLE, text, **{"Retry-After": "1"})

    async def _send(
        self,
        store: AvatarStore,
        websocket: RelaySocket,
        request: Request,
        identity: str,
        size: int,
    ) -> Response:
        """Write the whole answer to the socket and close it; return its head."""
        headers = {**_FILE_HEADERS, "Content-Length": str(size), "Vary": "Origin"}
        origin = ",".join(request.headers.get_all("Origin"))
        if origin in self._origins:
            headers["Access-Control-Allow-Origin"] = origin
        headers |= {"Date": formatdate(usegmt=True), "Connection": "close"}
        head = Response(HTTPStatus.OK, HTTPStatus.OK.phrase, Headers(headers))
        data = await store.read(identity, 0, min(READ_BYTES, size))
        websocket.note_opened()  # its handshake is over, so to say
        transport = websocket.transport
        sock = transport.get_extra_info("socket")
        set_tcp_option(sock, socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._stats["downloads"] += 1
        self._transfers.add(websocket)
        try:
            async with asyncio.timeout(store.config.longest_s(size)):
                transport.write(head.serialize())
                for begin in range(0, size, READ_BYTES):
                    if begin:
                        data = await store.read(identity, begin, min(begin + READ_BYTES, size))
                    await self._send_pieces(store, websocket, data)
                transport.close()
                await websocket.wait_closed()
        except (TimeoutError, OSError):
            self._stats["downloads_cut"] += 1
            transport.abort()
            await websocket.wait_closed()
        finally:
            self._transfers.discard(websocket)
        return head

    async def _send_pieces(self, store: AvatarStore, websocket: RelaySocket, data: bytes) -> None:
        for begin in range(0, len(data), PIECE_BYTES):
            piece = data[begin : begin + PIECE_BYTES]
            await store.wait_for_turn(len(piece))
            if websocket.transport.is_closing():
                raise ConnectionResetError("the reader has gone")
            websocket.transport.write(piece)
            await websocket.drain()
            self._stats["download_bytes"] += len(piece)


def _refusal(websocket: RelaySocket, status: HTTPStatus, text: str, **more: str) -> Response:
    """Say no, in a line for people."""
    response = websocket.respond(status, f"{text}\n")
    response.headers.update({"Cache-Control": "no-store", **more})
    return response
