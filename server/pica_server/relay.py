"""The relay's shell: websockets on one side, the hub on the other, and nothing decided here.

What the websockets receive in one turn of the event loop is fed to the hub together, see
``relay_socket``, and then whoever has got something is sent it, so frames that arrive in one turn
leave in one message, under overload also those of a few milliseconds, see ``coalescing``. While the
kernel takes what is sent, that is all. Each websocket also has a reader, for the messages that do
not come the short way, and a writer, which waits for a peer that reads slowly and sends the
goodbye. A slow peer blocks nobody: what it has not taken yet stays in its outbox, where newer
frames replace older ones. One timer serves all deadlines.

The buffers behind an outbox are kept small, because what they hold can be neither replaced nor
withdrawn: one message in the transport and a bounded socket buffer in the kernel, of which unsent
bytes are bounded once more where the system can (``TCP_NOTSENT_LOWAT``).
"""

import asyncio
import logging
import secrets
import socket
import time
from collections.abc import Awaitable, Callable, Iterable, Sequence
from contextlib import suppress
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Origin, Subprotocol

from pica_protocol import SUBPROTOCOL
from pica_protocol.errors import CloseCode
from pica_protocol.limits import MAX_CLIENT_MESSAGE_BYTES
from pica_protocol.store import AVATARS_PATH, STORE_SUBPROTOCOL
from pica_server.admin import Admin
from pica_server.admin_server import AdminServer
from pica_server.certificate import Certificate
from pica_server.coalescing import WaitingLine
from pica_server.config import RelayConfig
from pica_server.connection import Connection
from pica_server.errors import AdmissionError, ListenError
from pica_server.hub import Hub
from pica_server.limits import SocketGuard
from pica_server.loop_watch import PERIOD_S, LoopWatch
from pica_server.notices import Notice
from pica_server.proxies import is_in, networks
from pica_server.relay_socket import RelaySocket, websocket_message
from pica_server.shared_frames import Parcel
from pica_server.status_pages import StatusPages
from pica_server.store import open_store
from pica_server.store_door import StoreDoor
from pica_server.tokens import KeyRing, admin_scope, admit, admit_upload, load_keys
from pica_server.webhook_sender import WebhookSender

if TYPE_CHECKING:
    from pica_server.cluster import Cluster

_MAX_QUEUED_MESSAGES = 16
"""Messages read ahead from one websocket before its socket is left alone."""
_WRITE_LIMIT_BYTES = 1  # of 0, TLS of the standard library would make no end of waiting
"""A writer goes on when the kernel has taken all of its last message. With a limit above that, the
library waits until three quarters of it have drained: seconds of a slow reader's time, in which its
streams fall behind and are cut."""
_UNSENT_LIMIT_BYTES = 2048
"""Of the kernel's buffer (chosen: about thirty frames)."""

_MOST_AT_ONCE = 8
"""Messages of one peer that are passed on in one turn of the loop (chosen: a quarter of a second of
a face that came late)."""

_logger = logging.getLogger(__name__)
# What strangers do to a public port (bad HTTP, cut handshakes) is no error of ours and no news.
_websockets_logger = logging.getLogger(f"{__name__}.websockets")
_websockets_logger.setLevel(logging.CRITICAL)


class Relay:
    """A relay that listens inside ``async with Relay(config) as relay``, and stops at its end.

    Raises:
        ConfigurationError: The certificate cannot be used.
        KeyFileError: The key file cannot be used.
        StoreError: The avatar store cannot be used.
        ListenError: On entry, when the address cannot be bound.
        ClusterError: On entry, when the cluster cannot be joined.
    """

    def __init__(
        self,
        config: RelayConfig,
        *,
        unix_time: Callable[[], float] = time.time,
        processor_time: Callable[[], float] = time.thread_time,
    ) -> None:
        """Prepare to listen.

        Args:
            config: Where, and the limits.
            unix_time: The clock that tokens are checked against.
            processor_time: What the event loop's thread has used of its core until now, seconds.
        """
        self.config = config
        keys: KeyRing | None = None if config.keys is None else load_keys(config.keys)
        self.hub = Hub(
            config,
            None if keys is None else lambda join: admit(keys, join, now=unix_time()),
            new_secret=_new_secret,
            notify=self._notify,
        )
        self.webhooks: WebhookSender | None = None
        if config.webhook.url:
            counts = self.hub.stats.webhooks
            self.webhooks = WebhookSender(config.webhook, counts, unix_time=unix_time)
        self.admin: AdminServer | None = None
        if config.admin_port is not None:
            may_manage = (
                None if keys is None else lambda token: admin_scope(keys, token, now=unix_time())
            )
            self.admin = AdminServer(Admin(self.hub, may_manage), self._after_events)

        def may_upload(token: str, avatar: str) -> None:
            if keys is not None:
                admit_upload(keys, token, avatar, now=unix_time())
            elif config.insecure:  # else strangers could fill the disk
                raise AdmissionError("this relay has no tokens to ask for", CloseCode.FORBIDDEN)

        self.store = open_store(config.avatar_store, config.store)
        self._door = StoreDoor(
            self.store,
            may_upload,
            self.hub.stats.store,
            origins=config.origins,
            offer_timeout_s=config.handshake_timeout_s,
        )
        self.certificate: Certificate | None = None
        if config.tls_cert is not None and config.tls_key is not None:
            self.certificate = Certificate(config.tls_cert, config.tls_key)
        self._proxies = networks(config.trusted_proxies)
        self._metrics_to = networks(config.metrics_to)
        limits = config.limits
        # Twice: of sockets that are closing, and of those that are told why they must.
        per_address = 2 * limits.connections_per_address
        self._guard = SocketGuard(handshakes=limits.handshakes, per_address=per_address)
        self._server: Server | None = None
        self._all_gone = asyncio.Event()
        self._drain_ends_s: float | None = None
        self._cluster: Cluster | None = None
        self._wakers: dict[Connection, _Waker] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._timer_s: float | None = None
        # What was received in this turn of the loop, and when; the hub gets it soon.
        self._inbox: list[tuple[Connection, bytes, float]] = []
        # Who sent so much of it that no more is read of them for now; as many as connections.
        self._unread: dict[Connection, asyncio.Transport] = {}
        self._loop_time: Callable[[], float] = time.monotonic
        self._soon: asyncio.Handle | None = None
        self._watch = LoopWatch()
        self._processor_time = processor_time
        self._pages = StatusPages(self.hub, self._watch, config, self.store)
        self._watching: asyncio.TimerHandle | None = None
        self._held: WaitingLine[Connection] = WaitingLine()
        self._release: asyncio.TimerHandle | None = None

    @property
    def url(self) -> str:
        """Where it listens, with the port that it really has."""
        assert self._server is not None, "only while it listens"
        host, port = self._server.sockets[0].getsockname()[:2]
        scheme = "ws" if self.certificate is None else "wss"
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
        self._loop_time = asyncio.get_running_loop().time
        if config.cluster:
            # Only here: a relay alone needs no NATS.
            from pica_server.cluster import Cluster

            self._cluster = Cluster(
                config.cluster, self.hub, config.room_capacity, self._after_turn_soon
            )
            await self._cluster.start()
        server = serve(
            self._serve,
            config.host,
            config.port,
            create_connection=self._guarded_connection,  # type: ignore[arg-type]
            process_request=self._answer,
            # Without an allow-list any web page could join from the browser of somebody nearby.
            origins=[None, *map(Origin, config.origins)],
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
            reuse_port=config.share_port or None,
            **self._tls(),
        )
        try:
            self._server = await server
        except OSError as error:
            if self._cluster is not None:
                await self._cluster.stop()
            raise ListenError(
                f"cannot listen on {config.host}:{config.port}: {error.strerror or error}; "
                "choose another --port (0 takes a free one) or --host"
            ) from error
        if self.webhooks is not None:
            self.webhooks.start()
        if self.admin is not None and config.admin_port is not None:
            tls = None if self.certificate is None else self.certificate.context
            try:
                await self.admin.start(config.admin_host, config.admin_port, tls)
            except ListenError:
                await self.__aexit__(None, None, None)
                raise
        self._watch_later()
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        assert self._server is not None
        if self.admin is not None:
            await self.admin.stop()
        self._server.close(close_connections=False)
        self.hub.close_all(CloseCode.GOING_AWAY, "the relay is stopping", self._now())
        self._after_events()
        self._door.close()
        await self._server.wait_closed()
        if self._cluster is not None:
            await self._cluster.stop()
        if self.store is not None:
            self.store.close()
        if self.webhooks is not None:
            await self.webhooks.stop(self.config.close_timeout_s)
        for handle in (self._timer, self._watching, self._release, self._soon):
            if handle is not None:
                handle.cancel()

    def _tls(self) -> dict[str, Any]:
        if self.certificate is None:
            return {}
        return {
            "ssl": self.certificate.context,
            "ssl_handshake_timeout": self.config.handshake_timeout_s,
            "ssl_shutdown_timeout": self.config.close_timeout_s,
        }

    def _answer(
        self, websocket: ServerConnection, request: Request
    ) -> Response | Awaitable[Response] | None:
        """Answer a plain HTTP request; None lets a websocket begin."""
        assert isinstance(websocket, RelaySocket)
        websocket.note_request(request)
        is_local = websocket.is_local or is_in(websocket.direct_from, self._metrics_to)
        if request.path.startswith(AVATARS_PATH):
            return self._door.answer(websocket, request)
        page = self._pages.answer(request.path, is_local=is_local, now=self._now())
        if page is None:
            return None
        response = websocket.respond(page.status, page.text)
        del response.headers["Content-Type"]
        response.headers["Content-Type"] = page.content_type
        return response

    async def drain(self) -> None:
        """Send everybody away in good order, and return when they are gone.

        Meanwhile the relay answers on, but lets nobody in. Whoever has not gone after ``drain_s``
        is cut.
        """
        drain_s = self.config.drain_s
        self._drain_ends_s = self._now() + drain_s
        self._all_gone.clear()
        self.hub.drain(self._now())
        self._after_events()
        if self._wakers:
            with suppress(TimeoutError):
                async with asyncio.timeout(drain_s):
                    await self._all_gone.wait()
        self.cut()

    def cut(self) -> None:
        """Cut every websocket without another word."""
        for waker in self._wakers.values():
            waker.websocket.transport.abort()

    def _notify(self, notice: Notice) -> None:
        if self.webhooks is not None:
            self.webhooks.notify(notice)

    def _watch_later(self) -> None:
        loop = asyncio.get_running_loop()
        due_s = loop.time() + PERIOD_S

        def look() -> None:
            self._watch.note(due_s, loop.time())
            self.hub.note_load(self._processor_time(), loop.time())
            self._watch_later()

        self._watching = loop.call_at(due_s, look)

    def _guarded_connection(self, *args: Any, **kwargs: Any) -> RelaySocket:
        connection = RelaySocket(*args, **kwargs)
        connection.guard = self._guard
        connection.handshake_timeout_s = self.config.handshake_timeout_s
        connection.stats = self.hub.stats
        connection.proxies = self._proxies
        return connection

    async def _serve(self, websocket: ServerConnection) -> None:
        """Serve one websocket until it has ended; the server owns this task."""
        assert isinstance(websocket, RelaySocket)
        websocket.note_opened()
        if websocket.subprotocol == STORE_SUBPROTOCOL:
            await self._door.serve(websocket)
            return
        _bound_kernel_buffer(websocket, self.config.send_buffer_bytes)
        began_s = self._now()
        connection = self.hub.connect(began_s, websocket.address)
        waker = self._wakers[connection] = _Waker(websocket)
        try:
            if websocket.subprotocol is None:
                reason = f"speak the websocket sub-protocol {SUBPROTOCOL}"
                self.hub.close(connection, CloseCode.WRONG_VERSION, reason, self._now())
            self._after_events()
            websocket.hand_to(lambda data: self._on_message(connection, data))
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._read(websocket, connection))
                tasks.create_task(self._write(websocket, connection, waker))
        except Exception:
            _logger.exception("connection failed", extra={"connection": connection.serial})
            raise  # the library closes the websocket with 1011
        finally:
            waker.cancel_cut()
            self.hub.disconnect(connection, CloseCode.INTERNAL_ERROR, "", self._now())
            del self._wakers[connection]
            self._after_events()
            self._log_closed(connection, began_s)
            if not self._wakers:
                self._all_gone.set()

    def _log_closed(self, connection: Connection, began_s: float) -> None:
        # Strangers who are not let in come by the thousand; metrics count them.
        level = logging.INFO if connection.has_joined else logging.DEBUG
        closed = connection.closed
        code = CloseCode.INTERNAL_ERROR if closed is None else closed.code
        fields = {
            "connection": connection.serial,
            "code": int(code),
            "by_peer": closed is not None and closed.is_remote,
            "seconds": round(self._now() - began_s, 3),
        }
        _logger.log(level, "connection closed", extra=fields)

    def _on_message(self, connection: Connection, data: bytes) -> None:
        """Keep a message that came the short way until all sockets have been read in this turn.

        First to read them all, then to decide, then to write: mixed, the network's code and ours
        drive each other out of the processor's caches.
        """
        self._inbox.append((connection, data, self._loop_time()))
        self._after_turn_soon()

    def _after_turn_soon(self) -> None:
        if self._soon is None:
            self._soon = asyncio.get_running_loop().call_soon(self._after_turn)

    def _after_turn(self) -> None:
        """Feed the hub with what has come in this turn.

        What a peer sends in one go, as after a stall, is passed on one by one: two of its frames
        must not replace each other although their receivers are not slow. So first goes the first
        message of everybody, then the second: a relay that is late finds two of each, and frames of
        different peers then still share their messages. Who sends more than `_MOST_AT_ONCE` waits
        for the next turn with the rest, and is not read meanwhile: a flood costs its own peer time.
        """
        self._soon = None
        inbox, self._inbox = self._inbox, []
        for _ in range(_MOST_AT_ONCE):
            if not inbox:
                break
            fed: set[Connection] = set()
            later: list[tuple[Connection, bytes, float]] = []
            for item in inbox:
                connection, data, now = item
                if connection in fed:
                    later.append(item)
                    continue
                fed.add(connection)
                try:
                    self.hub.receive(connection, data, now)
                except Exception:  # a fault of ours; it must not cost anybody else anything
                    _logger.exception("connection failed", extra={"connection": connection.serial})
                    self.hub.close(connection, CloseCode.INTERNAL_ERROR, "relay fault", now)
            self._after_events(may_hold=not later)
            inbox = later
        if inbox or self._unread:
            self._read_later(inbox)

    def _read_later(self, rest: list[tuple[Connection, bytes, float]]) -> None:
        """Keep what is left of a turn for the next one, and read no more of those who sent it."""
        waiting = {connection for connection, _, _ in rest}
        for connection in [each for each in self._unread if each not in waiting]:
            self._unread.pop(connection).resume_reading()
        for connection in waiting:
            waker = self._wakers.get(connection)
            if waker is not None and connection not in self._unread:
                transport = self._unread[connection] = waker.websocket.transport
                transport.pause_reading()
        if rest:
            self._inbox = rest
            self._after_turn_soon()

    async def _read(self, websocket: RelaySocket, connection: Connection) -> None:
        """Feed the hub with what came the long way, and tell it how the websocket ended."""
        try:
            while True:
                data = await websocket.recv()
                self.hub.receive(connection, data, self._now())
                self._after_events()
                # recv() does not yield while messages are queued. The writers get their turn first:
                # else a flood starves them, and two frames that came together replace each other
                # although their receivers are not slow.
                await asyncio.sleep(0)
        except ConnectionClosed:
            code = websocket.close_code or CloseCode.CONNECTION_LOST
            self.hub.disconnect(connection, code, websocket.close_reason or "", self._now())
            self._after_events()

    async def _write(self, websocket: RelaySocket, connection: Connection, waker: "_Waker") -> None:
        """Send what could not be sent at once, and the goodbye."""
        hub = self.hub
        try:
            while True:
                if waker.under_way is not None:
                    await websocket.drain()
                    hub.sent(connection, waker.under_way, self._now())
                    waker.under_way = None
                while (parcel := hub.take(connection, self._now())) is not None:
                    await websocket.send(parcel.data)
                    hub.sent(connection, parcel, self._now())
                if connection.closed is not None:
                    websocket.close_timeout = self._close_timeout_s()
                    await websocket.close(connection.closed.code, connection.closed.reason)
                    return
                await waker.wait()
        except ConnectionClosed:
            return

    def _after_events(self, *, may_hold: bool = True) -> None:
        """Send to those who have got something, and set the timer to the next deadline.

        Args:
            may_hold: Frames may wait for company; not where another of the same publisher follows,
                for too many that wait for one receiver would be thinned.
        """
        if self._cluster is not None:
            self._cluster.step()
        window_s = self.hub.coalescing_s
        due_s = self._now() + window_s
        ready = self.hub.take_ready()
        if window_s > 0 and may_hold:
            for connection in ready:
                if not connection.is_urgent:
                    self._held.join(connection, due_s)
            ready = [connection for connection in ready if connection.is_urgent]
        self._send_all(ready)
        if self._release is None:
            self._release_later()
        when = self.hub.next_timer()
        if when != self._timer_s:
            if self._timer is not None:
                self._timer.cancel()
            loop = asyncio.get_running_loop()
            self._timer = None if when is None else loop.call_at(when, self._on_timer)
            self._timer_s = when

    def _send_all(self, connections: Iterable[Connection]) -> None:
        """Send what waits for some, as far as the kernel takes it; leave the rest to the writers.

        First to take what goes out, then to write it, see `_on_message`.
        """
        # Once for every message that goes out: written for speed.
        wakers, now = self._wakers, self._loop_time()
        taken: list[tuple[Connection, _Waker, Parcel]] = []
        for connection in connections:
            waker = wakers.get(connection)
            if waker is None:
                continue
            if waker.is_idle and connection.closed is None and waker.websocket.is_writable:
                parcel = connection.outbox.take(now)
                if parcel is not None:
                    taken.append((connection, waker, parcel))
                if not connection.outbox.is_waiting:
                    continue
            waker.wake()
            if connection.closed is not None:
                waker.cut_after(self._close_timeout_s())
        written: list[Parcel] = []
        last, framed = None, b""
        for connection, waker, parcel in taken:
            if parcel is not last:  # many get the very same
                last, framed = parcel, websocket_message(parcel.data)
            if waker.websocket.write(framed):
                written.append(parcel)
            else:
                self.hub.is_sending(connection, now)
                waker.under_way = parcel
                waker.wake()
        self.hub.all_sent(written, self._loop_time())

    def _release_later(self) -> None:
        when = self._held.next_timer()
        if when is not None:
            self._release = asyncio.get_running_loop().call_at(when, self._release_due)

    def _release_due(self) -> None:
        """Let go those who have waited for company long enough."""
        self._send_all(self._held.take_due(self._now()))
        self._release = None
        self._release_later()

    def _on_timer(self) -> None:
        # A loop may fire a timer up to its clock's resolution too early; a deadline that is not met
        # then would be set again and again without the clock moving on.
        due = self._timer_s or 0.0
        self._timer = self._timer_s = None
        self.hub.handle_timer(max(self._now(), due))
        self._after_events()

    def _close_timeout_s(self) -> float:
        """How long a peer may take to read the rest and to close."""
        if self._drain_ends_s is None:
            return self.config.close_timeout_s
        # Nobody needs the place, and what waits for a slow reader is to reach it.
        return max(self._drain_ends_s - self._now(), self.config.close_timeout_s)

    def _now(self) -> float:
        return self._loop_time()


class _Waker:
    """Wakes one writer, and cuts the socket of a peer that does not let us close it in time.

    Attributes:
        websocket: What the writer writes to.
        is_idle: Whether the writer has nothing to do.
        under_way: Written by somebody else, and not taken by the kernel yet.
    """

    def __init__(self, websocket: RelaySocket) -> None:
        self.websocket = websocket
        self.is_idle = False
        self.under_way: Parcel | None = None
        self._event = asyncio.Event()
        self._cut: asyncio.TimerHandle | None = None

    async def wait(self) -> None:
        self.is_idle = not self._event.is_set()
        await self._event.wait()
        self._event.clear()

    def wake(self) -> None:
        self.is_idle = False
        self._event.set()

    def cut_after(self, timeout_s: float) -> None:
        if self._cut is None:
            # The library's own close_timeout starts only once its buffer has drained, and the
            # buffer of a peer that does not read never drains.
            loop = asyncio.get_running_loop()
            self._cut = loop.call_later(timeout_s, self.websocket.transport.abort)

    def cancel_cut(self) -> None:
        if self._cut is not None:
            self._cut.cancel()


def _new_secret() -> str:
    """Return 128 bits that nobody can guess."""
    return secrets.token_urlsafe(16)


def _select_subprotocol(
    _websocket: ServerConnection, offered: Sequence[Subprotocol]
) -> Subprotocol | None:
    # Whoever offers none is let in and told so with a close code: clearer than an HTTP 400.
    for known in (SUBPROTOCOL, STORE_SUBPROTOCOL):
        if known in offered:
            return Subprotocol(known)
    return None


def _bound_kernel_buffer(websocket: ServerConnection, send_buffer_bytes: int) -> None:
    sock = websocket.transport.get_extra_info("socket")
    if sock is None or sock.family not in (socket.AF_INET, socket.AF_INET6):
        return
    with suppress(OSError):  # the peer may be gone already; the reader will find out
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, send_buffer_bytes)
        if hasattr(socket, "TCP_NOTSENT_LOWAT"):
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, _UNSENT_LIMIT_BYTES)
