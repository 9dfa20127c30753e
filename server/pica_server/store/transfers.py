"""The ways into and out of the avatar store, which must not delay the faces.

A file comes over a websocket of ``pica.store.1``, one each, and leaves by HTTP (RFC 9110) on the
port of the faces. A transfer moves 16 KiB at a time and lets others have their turn after each; a
download is never further ahead of its reader than a small socket buffer, so that it does not fill
the queue of a slow link through which a call goes too.
Transfers are limited in number, in all and for each address, and one that is slower than it may be
is cut.

A websocket library answers small things by HTTP, whole and from memory. A file is written to the
socket by hand here; the library then finds the connection closed and does nothing more.
"""

import asyncio
import logging
import socket
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from email.utils import formatdate
from http import HTTPStatus
from typing import Final

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from pica_protocol.codec import decode_chunk, decode_message, encode_message
from pica_protocol.errors import CloseCode, RemoteProtocolError
from pica_protocol.limits import clipped_reason, is_avatar_id
from pica_protocol.messages import AVATARS_PATH, Bye, Offer, Ready, Stored
from pica_server.limits import RefusalError
from pica_server.net.socket import RelaySocket, set_tcp_option
from pica_server.store.store import AvatarStore, Slots

MOST_OFFERS: Final = 64
"""Websockets that have not offered anything yet (chosen: eight times the uploads)."""
RECEIVE_BUFFER_BYTES: Final = 131_072
"""Bytes of a file that the kernel may hold; those of a call are held to less (chosen)."""
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
class Transfers:
    """Gives the files of a store and takes others, or says that there is none.

    Attributes:
        moving: Sockets over which a file moves; the relay cuts them at its end.
    """

    _store: AvatarStore | None
    """The files; None: this relay keeps none."""
    _stats: Counter[str]
    _may_upload: Callable[[str, str], None]
    """Takes a token and an avatar's id; raises `RefusalError` if that must not be uploaded."""
    _offer_timeout_s: float
    """Seconds from the open websocket to the offer."""
    _origins: tuple[str, ...]
    """Web pages whose scripts may read what they get."""

    def __post_init__(self) -> None:
        self.moving: set[RelaySocket] = set()
        if self._store is not None:
            config = self._store.config
            self._downloads = Slots(config.downloads, config.downloads_per_address)
            # Who has not shown a token yet must not hold the places of those who have.
            self._offers = Slots(MOST_OFFERS, config.uploads_per_address)
            self._uploads = Slots(config.uploads, config.uploads_per_address)

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
            with self._downloads.taken(websocket.address):
                size = await store.size(identity)
                if not size:
                    return _refusal(websocket, HTTPStatus.NOT_FOUND, "no such avatar here")
                return await self._send(store, websocket, request, identity, size)
        except RefusalError:
            self._stats["downloads_refused"] += 1
            text = "too many downloads, try again"
        except OSError as error:
            self._note_fault(error)
            text = "the store does not answer"
        return _refusal(websocket, HTTPStatus.SERVICE_UNAVAILABLE, text, **{"Retry-After": "1"})

    async def _send(
        self, store: AvatarStore, websocket: RelaySocket, request: Request, identity: str, size: int
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
        self.moving.add(websocket)
        try:
            async with asyncio.timeout(store.config.longest_s(size)):
                transport.write(head.serialize())
                for begin in range(0, size, READ_BYTES):
                    if begin:
                        data = await store.read(identity, begin, min(begin + READ_BYTES, size))
                    await self._send_pieces(websocket, data)
                transport.close()
                await websocket.wait_closed()
        except (TimeoutError, OSError):
            self._stats["downloads_cut"] += 1
            transport.abort()
            await websocket.wait_closed()
        finally:
            self.moving.discard(websocket)
        return head

    async def _send_pieces(self, websocket: RelaySocket, data: bytes) -> None:
        for begin in range(0, len(data), PIECE_BYTES):
            piece = data[begin : begin + PIECE_BYTES]
            if websocket.transport.is_closing():
                raise ConnectionResetError("the reader has gone")
            websocket.transport.write(piece)
            await websocket.drain()
            await asyncio.sleep(0)  # a reader that keeps up does not make it wait
            self._stats["download_bytes"] += len(piece)

    async def serve(self, websocket: RelaySocket) -> None:
        """Take one file."""
        self.moving.add(websocket)
        sock = websocket.transport.get_extra_info("socket")
        set_tcp_option(sock, socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        try:
            code, reason = await self._take(websocket)
            outcome = "uploads_done" if code == CloseCode.NORMAL else "uploads_refused"
            self._stats[outcome] += 1
            reason = clipped_reason(reason)
            await websocket.send(encode_message(Bye(code=code, reason=reason)))
            await websocket.close(code, reason)
        except ConnectionClosed:
            self._stats["uploads_cut"] += 1
        finally:
            self.moving.discard(websocket)

    async def _take(self, websocket: RelaySocket) -> tuple[CloseCode, str]:
        """Take a file; return how it ended, for the other side."""
        if self._store is None:
            return CloseCode.WRONG_VERSION, "this relay keeps no avatars"
        try:
            with self._offers.taken(websocket.address):
                offer = await self._offer(websocket)
            with self._uploads.taken(websocket.address):
                stored = await self._receive(websocket, self._store, offer)
                await websocket.send(encode_message(stored))
        except (RemoteProtocolError, RefusalError) as error:
            return error.code, str(error)
        except TimeoutError:
            return CloseCode.TOO_SLOW, "the offer or the file came too slowly"
        except OSError as error:
            self._note_fault(error)
            return CloseCode.INTERNAL_ERROR, "the store has a fault"
        return CloseCode.NORMAL, ""

    async def _offer(self, websocket: RelaySocket) -> Offer:
        """Take the offer of a peer that may make it."""
        async with asyncio.timeout(self._offer_timeout_s):
            offer = decode_message(await _binary(websocket))
        if not isinstance(offer, Offer):
            raise RemoteProtocolError("an offer comes first", CloseCode.UNEXPECTED_MESSAGE)
        self._may_upload(offer.token, offer.sha256)
        return offer

    async def _receive(self, websocket: RelaySocket, store: AvatarStore, offer: Offer) -> Stored:
        """Take the file; return what to say then."""
        if await store.size(offer.sha256) is not None:
            self._stats["uploads_known"] += 1
            return Stored()
        data = bytearray()
        with store.reserved(offer.size):
            async with asyncio.timeout(store.config.longest_s(offer.size)):
                await websocket.send(encode_message(Ready()))
                while len(data) < offer.size:
                    chunk = decode_chunk(await _binary(websocket))
                    self._stats["upload_bytes"] += len(chunk)
                    data += chunk
            if len(data) > offer.size:
                raise RefusalError("more bytes than were offered", CloseCode.UNFIT_FILE)
            await store.keep(offer.sha256, data)
        self._stats["uploads_kept"] += 1
        return Stored(is_new=True)

    def _note_fault(self, error: OSError) -> None:
        self._stats["faults"] += 1
        _logger.warning("avatar store failed", extra={"error": type(error).__name__})


def _refusal(websocket: RelaySocket, status: HTTPStatus, text: str, **more: str) -> Response:
    """Say no, in a line for people."""
    response = websocket.respond(status, f"{text}\n")
    response.headers.update({"Cache-Control": "no-store", **more})
    return response


async def _binary(websocket: RelaySocket) -> bytes:
    data = await websocket.recv()
    if isinstance(data, str):
        raise RemoteProtocolError("a text message")
    return data
