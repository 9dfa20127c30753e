"""A relay: its port, its hub, and all that goes with them, put together and taken apart again.

What moves between the websockets and the hub, `pica_server.net.pump` moves.
"""

import asyncio
import logging
import secrets
import socket
import ssl
import time
from collections.abc import Awaitable, Callable, Sequence
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, Self

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from pica_protocol import SUBPROTOCOL
from pica_protocol.errors import CloseCode
from pica_protocol.limits import MAX_CLIENT_MESSAGE_BYTES
from pica_protocol.messages import AVATARS_PATH, STORE_SUBPROTOCOL
from pica_server.config import ConfigurationError, RelayConfig
from pica_server.limits import RefusalError, SocketGuard, is_in, is_loopback, most_sockets, networks
from pica_server.log import say
from pica_server.net.pump import Pump
from pica_server.net.socket import RelaySocket, set_tcp_option
from pica_server.pages import StatusPages, WebPage, avatar_files, face_networks, page_files
from pica_server.room.connections import PERIOD_S
from pica_server.room.hub import Hub
from pica_server.store.store import AvatarStore
from pica_server.store.transfers import Transfers
from pica_server.tokens import admin_scope, admit, admit_upload, load_keys

if TYPE_CHECKING:
    from pica_server.placement.placement import RoomPlacement

_RECEIVE_BUFFER_BYTES = 4096
"""Bytes of one client that the kernel may hold for the relay, and may round up (chosen: when it is
full, clients thin what they send; what is under way on a long line is no more, either)."""
_MAX_QUEUED_MESSAGES = 16
"""Messages read ahead from one websocket before its socket is left alone."""
_WRITE_LIMIT_BYTES = 1  # of 0, TLS of the standard library would make no end of waiting
"""A writer goes on when the kernel has taken all of its last message. With a limit above that, the
library waits until three quarters of it have drained: seconds of a slow reader's time, in which its
streams fall behind and are cut."""

READ_AGAIN_S = 600.0
"""Between two readings of the files of the certificate and of the keys, which may be replaced while
connections go on (chosen: two milliseconds of work)."""

_logger = logging.getLogger(__name__)
# What strangers do to a public port (bad HTTP, cut handshakes) is no error of ours and no news.
_websockets_logger = logging.getLogger(f"{__name__}.websockets")
_websockets_logger.setLevel(logging.CRITICAL)


class Relay:
    """A relay that listens inside ``async with Relay(config) as relay``, and stops at its end.

    Raises:
        ConfigurationError: The certificate, the key file or the avatar store cannot be used. On
            entry: the address cannot be bound, or NATS has no JetStream or does not let us in.
    """

    def __init__(
        self,
        config: RelayConfig,
        *,
        unix_time: Callable[[], float] = time.time,
        processor_s: Callable[[], float] = lambda: 0.0,
    ) -> None:
        """Prepare to listen.

        Args:
            unix_time: The clock that tokens are checked against.
            processor_s: How long this process has worked; by default it seems idle.
        """
        self.config = config
        self._processor_s = processor_s
        self._keys = keys = None if config.keys is None else load_keys(config.keys)
        self.hub = Hub(
            config,
            None if keys is None else lambda join: admit(keys, join, now=unix_time()),
            new_secret=lambda: secrets.token_urlsafe(16),  # 128 bits
        )
        self._pump = Pump(self.hub, config)

        def may_upload(token: str, avatar: str) -> None:
            if keys is not None:
                admit_upload(keys, token, avatar, now=unix_time())
            elif config.insecure:  # else strangers could fill the disk
                raise RefusalError("this relay has no tokens to ask for", CloseCode.FORBIDDEN)

        self.store: AvatarStore | None = None
        if config.avatar_store != "none":
            shipped = [*avatar_files(), *face_networks()]
            self.store = AvatarStore(config.avatar_store, config.store, shipped)
        counts = self.hub.stats.store
        self._transfers = Transfers(
            self.store, counts, may_upload, config.handshake_timeout_s, config.origins
        )
        self.tls = _tls_context(config)
        self._proxies = networks(config.trusted_proxies)
        self._metrics_to = networks(config.metrics_to)
        self._is_private = is_loopback(config.host)
        limits = config.limits
        # Twice: of sockets that are closing, and of those that are told why they must.
        per_address = 2 * limits.connections_per_address
        self._guard = SocketGuard(
            handshakes=limits.handshakes,
            per_address=per_address,
            per_s=limits.sockets_per_s,
            burst=limits.sockets_burst,
            most=most_sockets(),
        )
        self._silent: set[RelaySocket] = set()
        self._server: Server | None = None
        self._placement: RoomPlacement | None = None
        if config.cluster:
            # Only here: a relay alone needs no NATS.
            from pica_server.placement import bucket, placement

            self._placement = placement.RoomPlacement(
                bucket.Bucket(config.cluster), self.hub, self._follow, unix_time
            )
            self.hub.membership.placement = self._placement
        admin_room = (
            None if keys is None else lambda token: admin_scope(keys, token, now=unix_time())
        )
        self._pages = StatusPages(self.hub, config, self.store, admin_room)
        self._web_page = WebPage(page_files()) if config.web else None
        self._watching: asyncio.TimerHandle | None = None
        self._keeping: asyncio.Task[None] | None = None

    @property
    def url(self) -> str:
        """Where it listens, with the port that it really has."""
        assert self._server is not None, "only while it listens"
        host, port = self._server.sockets[0].getsockname()[:2]
        scheme = "ws" if self.tls is None else "wss"
        return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"

    def stats(self) -> dict[str, Any]:
        """Return the counters, and what is open now."""
        hub = self.hub
        return {
            "open_connections": hub.num_connections,
            "rooms": hub.num_rooms,
            **hub.stats.as_dict(),
        }

    async def __aenter__(self) -> Self:
        config = self.config
        self._pump.start()
        try:
            self._server = await serve(
                self._serve,
                # Both families, as elsewhere on Linux.
                host=["0.0.0.0", "::"] if config.host == "::" else config.host,  # type: ignore[arg-type]
                port=config.port,
                create_connection=self._guarded_connection,  # type: ignore[arg-type]
                process_request=self._answer,
                subprotocols=[Subprotocol(SUBPROTOCOL), Subprotocol(STORE_SUBPROTOCOL)],
                select_subprotocol=_select_subprotocol,
                compression=None,
                max_size=MAX_CLIENT_MESSAGE_BYTES,
                max_queue=_MAX_QUEUED_MESSAGES,
                write_limit=_WRITE_LIMIT_BYTES,
                open_timeout=None,  # a RelaySocket has one of its own
                ping_interval=config.ping_interval_s,
                ping_timeout=config.ping_interval_s,
                close_timeout=config.close_timeout_s,
                server_header=None,
                logger=_websockets_logger,
            )
        except OSError as error:
            raise ConfigurationError(
                f"cannot listen on {config.host}:{config.port}: {error.strerror or error}; "
                "choose another --port (0 takes a free one) or --host"
            ) from error
        for sock in self._server.sockets:  # a window that is made smaller later loses what comes
            set_tcp_option(sock, socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        if self._placement is not None:
            try:
                await self._placement.start(config.public_url or self.url)
            except ConfigurationError:
                await self.__aexit__(None, None, None)
                raise
        self._watch_later()
        self._keeping = asyncio.create_task(self._read_again())
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close(close_connections=False)
        # Those are not waited for until their handshake is late.
        for websocket in list(self._silent):
            websocket.give_up()
        self.hub.membership.close_all(CloseCode.GOING_AWAY, "the relay is stopping", self._now())
        self._pump.send_all()
        for websocket in self._transfers.moving:
            websocket.transport.abort()
        await self._server.wait_closed()
        if self._placement is not None:
            await self._placement.stop()
        if self.store is not None:
            self.store.close()
        self._pump.stop()
        for watching in (self._watching, self._keeping):
            if watching is not None:
                watching.cancel()

    async def _read_again(self) -> None:
        """Read certificate and keys again now and then: tokens of a removed key end. What cannot be
        used never replaces what can, and a connection keeps the certificate that it began with."""
        while True:
            await asyncio.sleep(READ_AGAIN_S)
            try:
                self.tls = _tls_context(self.config)
            except ConfigurationError as error:
                spoken = f"the old certificate stays: {error}"
                say(_logger, "certificate refused", spoken, why=str(error))
            if self._keys is None or self.config.keys is None:
                continue
            try:
                fresh = load_keys(self.config.keys)
            except ConfigurationError as error:
                say(_logger, "keys refused", f"the old keys stay: {error}", why=str(error))
                continue
            self._keys.clear()
            self._keys.update(fresh)

    def _answer(
        self, websocket: ServerConnection, request: Request
    ) -> Response | Awaitable[Response] | None:
        """Answer a plain HTTP request; None lets a websocket begin."""
        assert isinstance(websocket, RelaySocket)
        websocket.note_request(request)
        is_local = websocket.is_local or is_in(websocket.direct_from, self._metrics_to)
        if self._is_private and websocket.is_misnamed and "Upgrade" not in request.headers:
            text = "this relay is for its own machine: ask for 127.0.0.1 or localhost\n"
            return websocket.respond(HTTPStatus.FORBIDDEN, text)
        host = "".join(request.headers.get_all("Host"))
        if "Upgrade" in request.headers:
            if self._may_connect(websocket, request, host):
                return None
            text = "pages of this origin may not connect; --origins lists those that may\n"
            return websocket.respond(HTTPStatus.FORBIDDEN, text)
        if request.path.startswith(AVATARS_PATH):
            return self._transfers.answer(websocket, request)
        page = self._pages.answer(
            request.path,
            authorization=", ".join(request.headers.get_all("Authorization")),
            is_local=is_local,
            now=self._now(),
        )
        if page is None and self._web_page is not None:
            page = self._web_page.answer(request.path, host)
        if page is None:
            return None
        response = websocket.respond(page.status, page.text)
        del response.headers["Content-Type"]
        response.headers["Content-Type"] = page.content_type
        response.headers.update(page.headers)
        if request.method == "HEAD":
            response.body = b""
        return response

    def _may_connect(self, websocket: RelaySocket, request: Request, host: str) -> bool:
        """Return True unless a web page of another origin asks: it could join any room from the
        browser of a person nearby."""
        origins = request.headers.get_all("Origin")
        if not origins or set(origins) <= set(self.config.origins):
            return True
        # DNS rebinding: another site's name may point to this machine.
        is_own = self._web_page is not None and not (self._is_private and websocket.is_misnamed)
        return is_own and len(origins) == 1 and origins[0].partition("://")[2] == host

    async def drain(self) -> None:
        """Send everybody away in good order, and return when they are gone.

        Meanwhile the relay answers on, but admits no peers. A peer that has not gone after
        ``drain_s`` is cut.
        """
        await self._pump.drain(self.config.drain_s)
        self.cut()

    def cut(self) -> None:
        """Cut every websocket without another word."""
        self._pump.cut()

    def _follow(self, room: str, url: str | None) -> None:
        """Do what placement has decided."""
        self.hub.membership.follow(room, url, self._now())
        self._pump.after_turn_soon()

    def _watch_later(self) -> None:
        loop = asyncio.get_running_loop()
        began_s, worked_s = loop.time(), self._processor_s()
        due_s = began_s + PERIOD_S

        def look() -> None:
            now = loop.time()
            worked = (self._processor_s() - worked_s) / (now - began_s)
            self.hub.overload.note_turn(now - due_s, now, worked)
            self._pump.note_work(worked)
            self.hub.handle_timer(now)
            self._pump.send_all()
            self._watch_later()

        self._watching = loop.call_at(due_s, look)

    def _guarded_connection(self, *args: Any, **kwargs: Any) -> RelaySocket:
        connection = RelaySocket(*args, **kwargs)
        connection.guard = self._guard
        connection.silent = self._silent
        # Not the server's: the guard is to be asked before the dear work of a handshake begins.
        connection.tls = self.tls
        connection.handshake_timeout_s = self.config.handshake_timeout_s
        connection.stats = self.hub.stats
        connection.proxies = self._proxies
        return connection

    async def _serve(self, websocket: ServerConnection) -> None:
        """Serve one websocket until it has ended; the server owns this task."""
        assert isinstance(websocket, RelaySocket)
        websocket.note_opened()
        is_upload = websocket.subprotocol == STORE_SUBPROTOCOL
        try:
            await (self._transfers if is_upload else self._pump).serve(websocket)
        except Exception:  # a fault of ours, which the library would not log
            _logger.exception("connection failed")
            raise

    def _now(self) -> float:
        return asyncio.get_running_loop().time()


def _select_subprotocol(
    _websocket: ServerConnection, offered: Sequence[Subprotocol]
) -> Subprotocol | None:
    # A client that offers none is let in and told so with a close code: clearer than an HTTP 400.
    for known in (SUBPROTOCOL, STORE_SUBPROTOCOL):
        if known in offered:
            return Subprotocol(known)
    return None


def _tls_context(config: RelayConfig) -> ssl.SSLContext | None:
    """Read the certificate and its key, None without TLS; ConfigurationError with the flag and the
    fix if one of them cannot be used."""
    cert, key = config.tls_cert, config.tls_key
    if cert is None or key is None:
        return None
    for flag, path in (("tls-cert", cert), ("tls-key", key)):
        try:
            text = path.read_bytes()
        except OSError as error:
            raise ConfigurationError(f"--{flag} {path}: {error.strerror}") from error
        if b"-----BEGIN " not in text:
            raise ConfigurationError(f"--{flag} {path}: it is no PEM file")
        if flag == "tls-key" and b"ENCRYPTED" in text:
            fix = "a relay cannot ask for a password: `openssl pkey` takes it off"
            raise ConfigurationError(f"--{flag} {path}: it is encrypted, and {fix}")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.set_alpn_protocols(["http/1.1"])
    try:
        # A password would keep OpenSSL from asking on the terminal.
        context.load_cert_chain(cert, key, password="")
    except ssl.SSLError as error:
        if error.reason == "KEY_VALUES_MISMATCH":
            raise ConfigurationError(f"--tls-key {key}: it is not the key of {cert}") from error
        reason = (error.reason or "unreadable").replace("_", " ").lower()
        raise ConfigurationError(
            f"--tls-cert {cert}: it or its key {key} cannot be used: {reason}"
        ) from error
    return context
