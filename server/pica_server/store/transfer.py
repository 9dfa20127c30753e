"""The way in and out of the avatar store: files leave by HTTP and come by ``pica.store.1``.

Both share the port with the faces and must not delay them. So a transfer moves 16 KiB at a time
and waits for its turn after each; all transfers together keep to a rate, and to a lower one while
the event loop is late; and a download is never further ahead of its reader than a small socket
buffer, so that it does not fill the queue of a slow link through which a call goes too. Transfers
are limited in number, in all and for each address, and one that is slower than it may be is cut.

A websocket library answers small things by HTTP, whole and from memory. A file is written to the
socket by hand here; the library then finds the connection closed and does nothing more.
"""

import asyncio
import logging
import socket
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from email.utils import formatdate
from http import HTTPStatus
from typing import Final

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from pica_protocol.codec import decode_store_message, encode_message
from pica_protocol.errors import CloseCode, RemoteProtocolError
from pica_protocol.limits import clipped_reason
from pica_protocol.messages import Bye
from pica_protocol.store import (
    AVATARS_PATH,
    Offer,
    Ready,
    Stored,
    decode_chunk,
    is_avatar_id,
)
from pica_server.errors import AdmissionError, StoreError, StoreFullError, UnfitFileError
from pica_server.net.socket import RelaySocket
from pica_server.store.http import METHODS, Answer, Conditions, answer_for, refusal
from pica_server.store.store import AvatarStore

PIECE_BYTES: Final = 16 * 2**10
"""Written at once (chosen: as a message may have; the kernel takes it in some ten microseconds)."""
READ_BYTES: Final = 256 * 2**10
"""Read at once from the store, and held for one download."""
SEND_BUFFER_BYTES: Final = 32 * 2**10
"""How far a download may be ahead of its reader, in the kernel, which may double it (chosen: a
quarter of a second of a link with 2 Mbit/s; with 50 ms there and back still 5 Mbit/s)."""
MOST_OFFERS: Final = 64
"""Websockets that have not offered anything yet (chosen: eight times the uploads)."""
LEAD_S: Final = 0.002
"""So much too early a piece may go: event loops wait in whole milliseconds."""

TOLERANCE_S: Final = 0.002
"""So late a wait ends on a loop that has nothing to do."""
REST_FACTOR: Final = 4.0
LONGEST_REST_S: Final = 0.05
"""Chosen: with it, twenty at once still get files of 2.5 MB in half the time they may take."""

MayUpload = Callable[[str, str], None]
"""Takes a token and an avatar's id; raises `AdmissionError` if that must not be uploaded."""

_logger = logging.getLogger(__name__)


class BusyError(Exception):
    """There are as many transfers as there may be."""


class Slots:
    """Counts what goes on at the same time, in all and for each address. Pure."""

    def __init__(self, limit: int, per_address: int) -> None:
        self._limit = limit
        self._per_address = per_address
        self._count = 0
        self._by_address: Counter[str] = Counter()  # bounded by the limit

    @contextmanager
    def taken(self, address: str) -> Iterator[None]:
        """Hold one; an empty address has no limit of its own.

        Raises:
            BusyError: There is none.
        """
        is_many = bool(address) and self._by_address[address] >= self._per_address
        if is_many or self._count >= self._limit:
            raise BusyError
        self._count += 1
        self._by_address[address] += 1
        try:
            yield
        finally:
            self._count -= 1
            self._by_address[address] -= 1
            if not self._by_address[address]:
                del self._by_address[address]


class Pace:
    """Says how long to wait so that a rate is kept, whoever asks, and less on a busy loop. Pure."""

    def __init__(self, bytes_per_s: float) -> None:
        self._bytes_per_s = bytes_per_s
        self._free_s = 0.0

    def wait_s(self, num_bytes: int, now: float) -> float:
        """Return how long to wait before so many bytes go."""
        begin_s = max(self._free_s, now)
        self._free_s = begin_s + num_bytes / self._bytes_per_s
        return max(begin_s - now - LEAD_S, 0.0)

    def note_lateness(self, late_s: float, now: float) -> None:
        """Take note how late a wait has ended: what is late then, are the faces.

        All transfers rest for a multiple of it, so that they take a small part of a loop that has
        much to do, but never stop.
        """
        if late_s > TOLERANCE_S:
            self._free_s = max(self._free_s, now + min(REST_FACTOR * late_s, LONGEST_REST_S))


class StoreDoor:
    """Serves a store, or says that there is none."""

    def __init__(
        self,
        store: AvatarStore | None,
        may_upload: MayUpload,
        stats: Counter[str],
        *,
        origins: tuple[str, ...],
        offer_timeout_s: float,
    ) -> None:
        """Begin without transfers.

        Args:
            store: The files; None: this relay keeps none.
            may_upload: Who may give it some.
            stats: Where it counts what it does.
            origins: Web pages whose scripts may read what they get.
            offer_timeout_s: From the open websocket to the offer.
        """
        self._store = store
        self._may_upload = may_upload
        self._stats = stats
        self._origins = origins
        self._offer_timeout_s = offer_timeout_s
        self._transfers: set[RelaySocket] = set()
        if store is not None:
            config = store.config
            self._downloads = Slots(config.downloads, config.downloads_per_address)
            # Who has not shown a token yet must not hold the places of those who have.
            self._offers = Slots(MOST_OFFERS, config.uploads_per_address)
            self._uploads = Slots(config.uploads, config.uploads_per_address)
            self._pace = Pace(config.bytes_per_s)

    def close(self) -> None:
        """Cut all transfers: the relay is stopping."""
        for websocket in self._transfers:
            websocket.transport.abort()

    # Out, by HTTP

    async def answer(self, websocket: RelaySocket, request: Request) -> Response:
        """Answer a request below ``/avatars/``; for ``process_request``."""
        conditions = Conditions(
            range=_header(request, "Range") if request.method == "GET" else "",
            if_range=_header(request, "If-Range"),
            if_none_match=_header(request, "If-None-Match"),
        )
        identity = request.path.removeprefix(AVATARS_PATH).partition("?")[0]
        if self._store is None:
            answer = refusal(HTTPStatus.NOT_IMPLEMENTED, "this relay keeps no avatars")
        elif request.method not in METHODS:
            answer = refusal(HTTPStatus.METHOD_NOT_ALLOWED, "use GET; uploads: pica avatar push")
        elif not is_avatar_id(identity):
            answer = refusal(HTTPStatus.NOT_FOUND, "an avatar's id is its SHA-256, in 64 digits")
        else:
            try:
                with self._downloads.taken(websocket.address):
                    return await self._give(websocket, request, identity, conditions)
            except BusyError:
                self._stats["downloads_refused"] += 1
                answer = refusal(HTTPStatus.SERVICE_UNAVAILABLE, "too many downloads, try again")
            except OSError as error:
                self._stats["faults"] += 1
                _logger.warning("avatar store failed", extra={"error": type(error).__name__})
                answer = refusal(HTTPStatus.SERVICE_UNAVAILABLE, "the store does not answer")
        return self._response(websocket, request, answer)

    async def _give(
        self, websocket: RelaySocket, request: Request, identity: str, conditions: Conditions
    ) -> Response:
        assert self._store is not None
        size = await self._store.size(identity)
        if not size:
            answer = refusal(HTTPStatus.NOT_FOUND, "no such avatar here")
            return self._response(websocket, request, answer)
        answer = answer_for(identity, size, conditions)
        if request.method == "GET" and answer.begin < answer.end:
            await self._send(websocket, request, identity, answer)
        return self._response(websocket, request, answer)

    async def _send(
        self, websocket: RelaySocket, request: Request, identity: str, answer: Answer
    ) -> None:
        """Write the whole answer to the socket and close it."""
        assert self._store is not None
        data = await self._store.read(identity, answer.begin, _next(answer.begin, answer.end))
        websocket.note_opened()  # its handshake is over, so to say
        transport = websocket.transport
        _bound_send_buffer(transport)
        self._stats["downloads"] += 1
        async with self._transfer(websocket):
            try:
                async with asyncio.timeout(self._store.config.longest_s(answer.end - answer.begin)):
                    headers = self._headers(request, answer.headers)
                    transport.write(_head(answer.status, headers))
                    position = answer.begin
                    while not transport.is_closing():
                        await self._send_pieces(websocket, data)
                        position += len(data)
                        if position == answer.end:
                            break
                        data = await self._store.read(
                            identity, position, _next(position, answer.end)
                        )
                    transport.close()
                    await websocket.wait_closed()
            except (TimeoutError, OSError):
                self._stats["downloads_cut"] += 1
                transport.abort()
                await websocket.wait_closed()

    async def _send_pieces(self, websocket: RelaySocket, data: bytes) -> None:
        view = memoryview(data)
        for begin in range(0, len(view), PIECE_BYTES):
            piece = view[begin : begin + PIECE_BYTES]
            await self._wait_for_turn(len(piece))
            if websocket.transport.is_closing():
                return
            websocket.transport.write(piece)
            await websocket.drain()
            self._stats["download_bytes"] += len(piece)

    def _response(self, websocket: RelaySocket, request: Request, answer: Answer) -> Response:
        """Return what the library sends: everything but bytes of a file."""
        response = websocket.respond(answer.status, answer.text)
        if not answer.text:
            del response.headers["Content-Type"]
            del response.headers["Content-Length"]  # that of a HEAD is the file's
        for name, value in self._headers(request, answer.headers).items():
            with suppress(KeyError):
                del response.headers[name]
            response.headers[name] = value
        if request.method == "HEAD":
            response.body = b""
        return response

    def _headers(self, request: Request, headers: dict[str, str]) -> dict[str, str]:
        origin = _header(request, "Origin")
        if origin in self._origins and origin:
            exposed = "Accept-Ranges, Content-Length, Content-Range, ETag"
            headers = {
                **headers,
                "Access-Control-Allow-Origin": origin,
                "Access-Control-Expose-Headers": exposed,
            }
        return {**headers, "Vary": "Origin"} if self._origins else headers

    # In, by websocket

    async def serve(self, websocket: RelaySocket) -> None:
        """Take one file from a websocket of ``pica.store.1``."""
        async with self._transfer(websocket):
            try:
                code, reason = await self._take(websocket)
                outcome = "uploads_done" if code == CloseCode.NORMAL else "uploads_refused"
                self._stats[outcome] += 1
                reason = clipped_reason(reason)
                await websocket.send(encode_message(Bye(code=code, reason=reason)))
                await websocket.close(code, reason)
            except ConnectionClosed:
                self._stats["uploads_cut"] += 1

    async def _take(self, websocket: ServerConnection) -> tuple[CloseCode, str]:
        """Take a file.

        Returns:
            How it ended, for the other side.
        """
        assert isinstance(websocket, RelaySocket)
        store = self._store
        if store is None:
            return CloseCode.WRONG_VERSION, "this relay keeps no avatars"
        try:
            with self._offers.taken(websocket.address):
                offer = await self._offer(websocket)
            with self._uploads.taken(websocket.address):
                stored = await self._receive(websocket, store, offer)
                await websocket.send(encode_message(stored))
            return CloseCode.NORMAL, ""
        except BusyError:
            return CloseCode.BUSY, "too many uploads at once, try again"
        except _LateError as error:
            return error.code, str(error)
        except (RemoteProtocolError, AdmissionError) as error:
            return error.code, str(error)
        except UnfitFileError as error:
            return CloseCode.UNFIT_FILE, str(error)
        except StoreFullError as error:
            return CloseCode.STORE_FULL, str(error)
        except (StoreError, OSError) as error:
            self._stats["faults"] += 1
            _logger.warning("avatar store failed", extra={"error": type(error).__name__})
            return CloseCode.INTERNAL_ERROR, "the store has a fault"

    async def _offer(self, websocket: ServerConnection) -> Offer:
        """Take the offer, from somebody who may make it."""
        with _late_after(CloseCode.HANDSHAKE_TIMEOUT, "no offer came"):
            async with asyncio.timeout(self._offer_timeout_s):
                offer = decode_store_message(await _binary(websocket))
        if not isinstance(offer, Offer):
            raise RemoteProtocolError("an offer comes first", CloseCode.UNEXPECTED_MESSAGE)
        self._may_upload(offer.token, offer.sha256)
        return offer

    async def _receive(
        self, websocket: ServerConnection, store: AvatarStore, offer: Offer
    ) -> Stored:
        """Take the file; return what to say then."""
        if await store.size(offer.sha256) is not None:
            self._stats["uploads_known"] += 1
            return Stored()
        async with await store.begin_upload(offer.sha256, offer.size) as upload:
            with _late_after(CloseCode.TOO_SLOW, "the file came too slowly"):
                async with asyncio.timeout(store.config.longest_s(offer.size)):
                    await websocket.send(encode_message(Ready()))
                    while upload.num_missing:
                        chunk = decode_chunk(await _binary(websocket))
                        self._stats["upload_bytes"] += len(chunk)
                        await upload.write(chunk)
                        await self._wait_for_turn(len(chunk))
            checked = await upload.finish()
        self._stats["uploads_kept"] += 1
        return Stored(checked=checked)

    # Both

    @asynccontextmanager
    async def _transfer(self, websocket: RelaySocket) -> AsyncIterator[None]:
        self._transfers.add(websocket)
        try:
            yield
        finally:
            self._transfers.discard(websocket)

    async def _wait_for_turn(self, num_bytes: int) -> None:
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        wait_s = self._pace.wait_s(num_bytes, began_s)
        await asyncio.sleep(wait_s)
        now = loop.time()
        self._pace.note_lateness(now - began_s - wait_s, now)


class _LateError(Exception):
    def __init__(self, message: str, code: CloseCode) -> None:
        super().__init__(message)
        self.code = code


@contextmanager
def _late_after(code: CloseCode, reason: str) -> Iterator[None]:
    try:
        yield
    except TimeoutError as error:
        raise _LateError(reason, code) from error


async def _binary(websocket: ServerConnection) -> bytes:
    data = await websocket.recv()
    if isinstance(data, str):
        raise RemoteProtocolError("a text message")
    return data


def _header(request: Request, name: str) -> str:
    """A header's value; one that is there twice counts as not there."""
    values = request.headers.get_all(name)
    return values[0] if len(values) == 1 else ""


def _next(position: int, end: int) -> int:
    return min(position + READ_BYTES, end)


def _head(status: HTTPStatus, headers: dict[str, str]) -> bytes:
    lines = [f"HTTP/1.1 {status.value} {status.phrase}", f"Date: {formatdate(usegmt=True)}"]
    lines += [f"{name}: {value}" for name, value in headers.items()]
    return "\r\n".join([*lines, "Connection: close", "", ""]).encode("ascii")


def _bound_send_buffer(transport: asyncio.Transport) -> None:
    sock = transport.get_extra_info("socket")
    if sock is not None and sock.family in (socket.AF_INET, socket.AF_INET6):
        with suppress(OSError):  # the peer may be gone already
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
