"""The way out of the avatar store: files leave by HTTP (RFC 9110), on the port of the faces.

They must not delay them. So a transfer moves 16 KiB at a time and waits for its turn after each;
all transfers together keep to a rate; and a download is never further ahead of its reader than a
small socket buffer, so that it does not fill the queue of a slow link through which a call goes
too. Transfers are limited in number, in all and for each address, and one that is slower than it
may be is cut.

A file never changes: its name is its hash. So the entity tag is the hash, caches may keep it for
ever, and a range of it can be joined with what came before a connection broke.

A websocket library answers small things by HTTP, whole and from memory. A file is written to the
socket by hand here; the library then finds the connection closed and does nothing more.
"""

import asyncio
import logging
import re
import socket
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from email.utils import formatdate
from http import HTTPStatus
from typing import Final

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from pica_protocol.store import AVATARS_PATH, is_avatar_id
from pica_server.errors import BusyError
from pica_server.net.socket import RelaySocket, set_tcp_option
from pica_server.store.store import AvatarStore, Slots

PIECE_BYTES: Final = 16 * 2**10
"""Written at once (chosen: as a message may have; the kernel takes it in some ten microseconds)."""
READ_BYTES: Final = 256 * 2**10
"""Read at once from the store, and held for one download."""
SEND_BUFFER_BYTES: Final = 32 * 2**10
"""How far a download may be ahead of its reader, in the kernel, which may double it (chosen: a
quarter of a second of a link with 2 Mbit/s; with 50 ms there and back still 5 Mbit/s)."""

CACHE_CONTROL: Final = "public, max-age=31536000, immutable"

_RANGE = re.compile(r"bytes=(\d{1,18})-(\d{0,18})")
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True)
class Answer:
    """Status, headers, and which bytes of the file follow."""

    status: HTTPStatus
    headers: dict[str, str] = field(default_factory=dict)
    begin: int = 0
    end: int = 0
    text: str = ""
    """Instead of bytes of the file: for people."""


def answer_for(identity: str, size: int, asked: Mapping[str, str]) -> Answer:
    """Return the answer to a GET of a file that is there.

    Several ranges at once, those that count from the end, and ranges in other units are answered
    with the whole file, as the standard allows.

    Args:
        identity: The file's SHA-256 in hexadecimal.
        size: Its length in bytes, above 0.
        asked: The request's ``Range`` and ``If-Range``, where it has them.
    """
    tag = f'"{identity}"'
    headers = {
        "ETag": tag,
        "Cache-Control": CACHE_CONTROL,
        "Accept-Ranges": "bytes",
        "Content-Type": "application/octet-stream",
        "X-Content-Type-Options": "nosniff",
    }
    found = _RANGE.fullmatch(asked.get("Range", ""))
    if found is None or asked.get("If-Range", tag) != tag:
        return Answer(status=HTTPStatus.OK, headers=_of_length(headers, size), end=size)
    begin, end = int(found[1]), min(int(found[2] or size) + 1, size)
    if begin < end:
        headers["Content-Range"] = f"bytes {begin}-{end - 1}/{size}"
        headers = _of_length(headers, end - begin)
        return Answer(status=HTTPStatus.PARTIAL_CONTENT, headers=headers, begin=begin, end=end)
    status = HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE
    answer = refusal(status, f"the file has {size} bytes")
    answer.headers["Content-Range"] = f"bytes */{size}"
    return answer


def _of_length(headers: dict[str, str], num_bytes: int) -> dict[str, str]:
    return headers | {"Content-Length": str(num_bytes)}


def refusal(status: HTTPStatus, text: str) -> Answer:
    """Say no, in a line for people."""
    headers = {
        "Cache-Control": "no-store",
        "Content-Type": "text/plain; charset=utf-8",
        "Content-Length": str(len(text) + 1),
    }
    if status == HTTPStatus.METHOD_NOT_ALLOWED:
        headers["Allow"] = "GET"
    if status == HTTPStatus.SERVICE_UNAVAILABLE:
        headers["Retry-After"] = "1"
    return Answer(status=status, headers=headers, text=f"{text}\n")


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
            answer = refusal(HTTPStatus.NOT_IMPLEMENTED, "this relay keeps no avatars")
        elif request.method != "GET":
            answer = refusal(HTTPStatus.METHOD_NOT_ALLOWED, "use GET; uploads: pica avatar push")
        elif not is_avatar_id(identity):
            answer = refusal(HTTPStatus.NOT_FOUND, "an avatar's id is its SHA-256, in 64 digits")
        else:
            try:
                with self._slots.taken(websocket.address):
                    answer = await self._give(store, websocket, request, identity)
            except BusyError:
                self._stats["downloads_refused"] += 1
                answer = refusal(HTTPStatus.SERVICE_UNAVAILABLE, "too many downloads, try again")
            except OSError as error:
                self._stats["faults"] += 1
                _logger.warning("avatar store failed", extra={"error": type(error).__name__})
                answer = refusal(HTTPStatus.SERVICE_UNAVAILABLE, "the store does not answer")
        return self._response(request, answer)

    async def _give(
        self, store: AvatarStore, websocket: RelaySocket, request: Request, identity: str
    ) -> Answer:
        size = await store.size(identity)
        if not size:
            return refusal(HTTPStatus.NOT_FOUND, "no such avatar here")
        asked = {
            name: values[0]
            for name in ("Range", "If-Range")
            # A header that is there twice counts as not there.
            if len(values := request.headers.get_all(name)) == 1
        }
        answer = answer_for(identity, size, asked)
        if answer.begin < answer.end:
            await self._send(store, websocket, self._response(request, answer), identity, answer)
        return answer

    async def _send(
        self,
        store: AvatarStore,
        websocket: RelaySocket,
        head: Response,
        identity: str,
        answer: Answer,
    ) -> None:
        """Write the whole answer to the socket and close it."""
        position, end = answer.begin, answer.end
        data = await store.read(identity, position, min(position + READ_BYTES, end))
        websocket.note_opened()  # its handshake is over, so to say
        transport = websocket.transport
        sock = transport.get_extra_info("socket")
        set_tcp_option(sock, socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._stats["downloads"] += 1
        self._transfers.add(websocket)
        try:
            async with asyncio.timeout(store.config.longest_s(end - position)):
                transport.write(head.serialize())
                while not transport.is_closing():
                    await self._send_pieces(store, websocket, data)
                    position += len(data)
                    if position == end:
                        break
                    data = await store.read(identity, position, min(position + READ_BYTES, end))
                transport.close()
                await websocket.wait_closed()
        except (TimeoutError, OSError):
            self._stats["downloads_cut"] += 1
            transport.abort()
            await websocket.wait_closed()
        finally:
            self._transfers.discard(websocket)

    async def _send_pieces(self, store: AvatarStore, websocket: RelaySocket, data: bytes) -> None:
        for begin in range(0, len(data), PIECE_BYTES):
            piece = data[begin : begin + PIECE_BYTES]
            await store.wait_for_turn(len(piece))
            if websocket.transport.is_closing():
                return
            websocket.transport.write(piece)
            await websocket.drain()
            self._stats["download_bytes"] += len(piece)

    def _response(self, request: Request, answer: Answer) -> Response:
        """Return what the library sends: everything but bytes of a file."""
        headers = Headers(answer.headers)
        headers["Date"] = formatdate(usegmt=True)
        headers["Connection"] = "close"
        if self._origins:
            headers["Vary"] = "Origin"
        origins = request.headers.get_all("Origin")
        if len(origins) == 1 and origins[0] in self._origins:
            headers["Access-Control-Allow-Origin"] = origins[0]
            exposed = "Accept-Ranges, Content-Length, Content-Range, ETag"
            headers["Access-Control-Expose-Headers"] = exposed
        return Response(answer.status, answer.status.phrase, headers, answer.text.encode())
