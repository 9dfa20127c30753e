"""The way into the avatar store: one file each over a websocket of ``pica.store.1``."""

import asyncio
import logging
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Final

from websockets.exceptions import ConnectionClosed

from pica_protocol.codec import decode_store_message, encode_message
from pica_protocol.errors import CloseCode, RemoteProtocolError
from pica_protocol.limits import clipped_reason
from pica_protocol.messages import Bye
from pica_protocol.store import Offer, Ready, Stored, decode_chunk
from pica_server.errors import AdmissionError, StoreError, StoreRefusalError
from pica_server.net.socket import RelaySocket, bound_receive_buffer
from pica_server.store.store import AvatarStore, Slots

MOST_OFFERS: Final = 64
"""Websockets that have not offered anything yet (chosen: eight times the uploads)."""

RECEIVE_BUFFER_BYTES: Final = 131_072
"""Bytes of a file that the kernel may hold; those of a call are held to less (chosen)."""

_logger = logging.getLogger(__name__)


@dataclass(eq=False)
class Uploads:
    """Takes files into a store, or says that there is none."""

    _store: AvatarStore | None
    """The files; None: this relay keeps none."""
    _may_upload: Callable[[str, str], None]
    """Takes a token and an avatar's id; raises `AdmissionError` if that must not be uploaded."""
    _stats: Counter[str]
    _transfers: set[RelaySocket]
    """Where sockets are as long as a file moves; the relay cuts them at its end."""
    _offer_timeout_s: float
    """Seconds from the open websocket to the offer."""

    def __post_init__(self) -> None:
        if self._store is not None:
            config = self._store.config
            # Who has not shown a token yet must not hold the places of those who have.
            self._offers = Slots(MOST_OFFERS, config.uploads_per_address)
            self._slots = Slots(config.uploads, config.uploads_per_address)

    async def serve(self, websocket: RelaySocket) -> None:
        """Take one file."""
        self._transfers.add(websocket)
        bound_receive_buffer(websocket.transport.get_extra_info("socket"), RECEIVE_BUFFER_BYTES)
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
            self._transfers.discard(websocket)

    async def _take(self, websocket: RelaySocket) -> tuple[CloseCode, str]:
        """Take a file; return how it ended, for the other side."""
        if self._store is None:
            return CloseCode.WRONG_VERSION, "this relay keeps no avatars"
        try:
            with self._offers.taken(websocket.address):
                offer = await self._offer(websocket)
            with self._slots.taken(websocket.address):
                stored = await self._receive(websocket, self._store, offer)
                await websocket.send(encode_message(stored))
        except (RemoteProtocolError, AdmissionError, StoreRefusalError) as error:
            return error.code, str(error)
        except (StoreError, OSError) as error:
            self._stats["faults"] += 1
            _logger.warning("avatar store failed", extra={"error": type(error).__name__})
            return CloseCode.INTERNAL_ERROR, "the store has a fault"
        return CloseCode.NORMAL, ""

    async def _offer(self, websocket: RelaySocket) -> Offer:
        """Take the offer of a peer that may make it."""
        late = StoreRefusalError("no offer came", CloseCode.HANDSHAKE_TIMEOUT)
        async with _within(self._offer_timeout_s, late):
            offer = decode_store_message(await _binary(websocket))
        if not isinstance(offer, Offer):
            raise RemoteProtocolError("an offer comes first", CloseCode.UNEXPECTED_MESSAGE)
        self._may_upload(offer.token, offer.sha256)
        return offer

    async def _receive(self, websocket: RelaySocket, store: AvatarStore, offer: Offer) -> Stored:
        """Take the file; return what to say then."""
        if await store.size(offer.sha256) is not None:
            self._stats["uploads_known"] += 1
            return Stored()
        late = StoreRefusalError("the file came too slowly", CloseCode.TOO_SLOW)
        data = bytearray()
        with store.reserved(offer.size):
            async with _within(store.config.longest_s(offer.size), late):
                await websocket.send(encode_message(Ready()))
                while len(data) < offer.size:
                    chunk = decode_chunk(await _binary(websocket))
                    self._stats["upload_bytes"] += len(chunk)
                    data += chunk
                    await store.wait_for_turn(len(chunk))
            if len(data) > offer.size:
                raise StoreRefusalError("more bytes than were offered", CloseCode.UNFIT_FILE)
            await store.keep(offer.sha256, data)
        self._stats["uploads_kept"] += 1
        return Stored(is_new=True)


@asynccontextmanager
async def _within(limit_s: float, late: StoreRefusalError) -> AsyncIterator[None]:
    try:
        async with asyncio.timeout(limit_s):
            yield
    except TimeoutError as error:
        raise late from error


async def _binary(websocket: RelaySocket) -> bytes:
    data = await websocket.recv()
    if isinstance(data, str):
        raise RemoteProtocolError("a text message")
    return data
