"""What moves between the websockets of a relay and its hub, in each turn of the event loop.

What the websockets receive in one turn of the event loop is fed to the hub together, and then
whoever has got something is sent it, so frames that arrive in one turn leave in one message. While
the kernel takes what is sent, that is all. Each websocket also has a reader, for the messages that
do not come the short way (see `pica_server.net.socket`), and a writer, which waits for a peer that
reads slowly and sends the goodbye. While the core is busy, faces of a room are not fed to the hub
at once: they gather for `GATHER_S`, or until a voice or anything else comes in that room, and so
share their messages. A slow peer blocks nobody: what it has not taken yet stays in its outbox,
where newer frames replace older ones. One timer serves all deadlines of the hub, another one ends
what gathers.

The buffers behind an outbox are kept small, because what they hold can be neither replaced nor
withdrawn: one message in the transport and a bounded socket buffer in the kernel, of which unsent
bytes are bounded once more where the system can (``TCP_NOTSENT_LOWAT``).
"""

import asyncio
import logging
import socket
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from zlib import crc32

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from pica_protocol import SUBPROTOCOL
from pica_protocol.errors import CloseCode
from pica_protocol.frames import MEDIA_PREFIX
from pica_server.config.relay import RelayConfig
from pica_server.net.socket import RelaySocket, set_tcp_option, websocket_message
from pica_server.room.brake import GATHER_S
from pica_server.room.connection import Connection
from pica_server.room.hub import HOLD_STEP_S, Hub
from pica_server.room.outbox import OutboundMessage
from pica_server.room.room import Room

_UNSENT_LIMIT_BYTES = 2048
"""Unsent bytes in the kernel's buffer (chosen: about thirty frames)."""

_VOICE_UNSENT_BYTES = 512
"""The same where voices are heard (chosen: 64 ms at 64 kbit/s)."""

_MOST_AT_ONCE = 8
"""Messages of one peer that are passed on in one turn of the loop (chosen: a quarter of a second of
a face that came late)."""

_Inbox = dict[Connection, list[tuple[bytes, float]]]
"""Messages by who sent them, each with when it came."""

_logger = logging.getLogger(__name__)


class Pump:
    """Moves messages between websockets and one hub."""

    def __init__(self, hub: Hub, config: RelayConfig) -> None:
        self._hub = hub
        self._config = config
        self._all_gone = asyncio.Event()
        self._drain_ends_s: float | None = None
        self._wakers: dict[Connection, _Waker] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._timer_s: float | None = None
        # What was received in this turn of the loop from whom, and when; the hub gets it soon.
        self._inbox: _Inbox = {}
        # Who sent so much of it that no more is read of them for now; as many as connections.
        self._unread: dict[Connection, asyncio.Transport] = {}
        self._now: Callable[[], float] = time.monotonic
        self._soon: asyncio.Handle | None = None
        # Of each room until when it gathers, and what has come from whom.
        self._gathering: dict[Room | None, tuple[float, _Inbox]] = {}
        self._gather_timer: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Take the time from the running loop from now on."""
        self._now = asyncio.get_running_loop().time

    def stop(self) -> None:
        """Do nothing more; all websockets have ended."""
        for handle in (self._timer, self._soon, self._gather_timer):
            if handle is not None:
                handle.cancel()

    async def drain(self, longest_s: float) -> None:
        """Send everybody away in good order, and return when they are gone, or it is late."""
        self._drain_ends_s = self._now() + longest_s
        self._all_gone.clear()
        self._hub.drain(self._now())
        self.after_events()
        if self._wakers:
            with suppress(TimeoutError):
                async with asyncio.timeout(longest_s):
                    await self._all_gone.wait()

    def cut(self) -> None:
        """Cut every websocket without another word."""
        for waker in self._wakers.values():
            waker.websocket.transport.abort()

    async def serve(self, websocket: RelaySocket) -> None:
        """Serve one websocket of a call until it has ended."""
        sock, num_bytes = (
            websocket.transport.get_extra_info("socket"),
            self._config.send_buffer_bytes,
        )
        set_tcp_option(sock, socket.SOL_SOCKET, socket.SO_SNDBUF, num_bytes)
        _bound_unsent(websocket, _UNSENT_LIMIT_BYTES)
        began_s = self._now()
        connection = self._hub.connect(began_s, websocket.address)
        waker = self._wakers[connection] = _Waker(websocket)
        try:
            if websocket.subprotocol is None:
                reason = f"speak the websocket sub-protocol {SUBPROTOCOL}"
                self._hub.close(connection, CloseCode.WRONG_VERSION, reason, self._now())
            self.after_events()
            websocket.hand_to(lambda data: self._on_message(connection, data))
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._read(websocket, connection))
                tasks.create_task(self._write(websocket, connection, waker))
        except Exception:
            _logger.exception("connection failed", extra={"connection": connection.serial})
            raise  # the library closes the websocket with 1011
        finally:
            waker.cancel_cut()
            self._hub.disconnect(connection, CloseCode.INTERNAL_ERROR, "", self._now())
            del self._wakers[connection]
            self.after_events()
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
        """Keep a message that came the short way until all sockets have been read in this turn, or
        until what gathers in its room goes on."""
        now = self._now()
        waiting = self._inbox.get(connection)
        if waiting is not None:
            waiting.append((data, now))
            return
        _, gathered = self._gathering.get(connection.room, (0.0, ()))
        if connection not in gathered and self._hub.drop_late(connection, data, now):
            self.after_turn_soon()
        elif not self._gather(connection, data, now):
            # A voice takes along what gathers in its room; all else goes after it.
            self._release(connection.room, sends=data[:1] != MEDIA_PREFIX)
            self._inbox[connection] = [(data, now)]
            self.after_turn_soon()

    def _gather(self, connection: Connection, data: bytes, now: float) -> bool:
        """Let a message wait for others of its room, if it may; return whether it does."""
        hub, room = self._hub, connection.room
        if not hub.brake.is_gathering or room is None:
            return False
        if not hub.forwarding.may_gather(room, data):
            return False
        if room not in self._gathering:
            # Every room at moments of its own: else all leave at once after the first late turn.
            phase_s = crc32(room.name.encode()) / 2**32 * GATHER_S
            self._gathering[room] = now + GATHER_S - (now + phase_s) % GATHER_S, {}
            self._set_gather_timer(now)
        waiting = self._gathering[room][1].setdefault(connection, [])
        if len(waiting) == _MOST_AT_ONCE:
            self._release(room, sends=True)
            return False
        waiting.append((data, now))
        return True

    def _set_gather_timer(self, now: float) -> None:
        if self._gather_timer is None:
            loop = asyncio.get_running_loop()
            self._gather_timer = loop.call_at(now + HOLD_STEP_S, self._on_gathered)

    def _on_gathered(self) -> None:
        """Let the rooms go on whose time to gather is over."""
        now = self._now()
        self._gather_timer = None
        for room in [room for room, (ends_s, _) in self._gathering.items() if ends_s <= now]:
            self._release(room, sends=False)
        self.after_turn_soon()
        if self._gathering:
            self._set_gather_timer(now)

    def _release(self, room: Room | None, *, sends: bool) -> None:
        """Feed the hub with what has gathered in a room; what comes of it is sent now, or when the
        turn ends."""
        if room in self._gathering:
            _, gathered = self._gathering.pop(room)
            self._feed(gathered)
            if sends:
                self.after_events()

    def after_turn_soon(self) -> None:
        """See to it that what has come in this turn is dealt with when it is over."""
        if self._soon is None:
            self._soon = asyncio.get_running_loop().call_soon(self._after_turn)

    def _after_turn(self) -> None:
        """Feed the hub with what has come in this turn, and send what comes of it.

        Who sends more than `_MOST_AT_ONCE` waits for the next turn with the rest, and is not read
        meanwhile: a flood costs its own peer time.
        """
        self._soon = None
        inbox, self._inbox = self._inbox, {}
        inbox = self._feed(inbox)
        # Also when nothing has come: placement may have asked for this turn.
        self.after_events()
        if inbox or self._unread:
            self._read_later({each: some[_MOST_AT_ONCE:] for each, some in inbox.items()})

    def _feed(self, inbox: _Inbox) -> _Inbox:
        """Feed the hub; return whose messages are too many for now.

        What a peer sends in one go, as after a stall, is passed on one by one: two of its frames
        must not replace each other although their receivers are not slow. So first goes the first
        message of everybody, then the second: a relay that is late finds two of each, and frames of
        different peers then still share their messages.
        """
        for place in range(_MOST_AT_ONCE):
            if place:
                self.after_events()
            for connection, messages in inbox.items():
                data, now = messages[place]
                try:
                    self._hub.receive(connection, data, now)
                except Exception:  # a fault of ours; it must not cost anybody else anything
                    _logger.exception("connection failed", extra={"connection": connection.serial})
                    self._hub.close(connection, CloseCode.INTERNAL_ERROR, "relay fault", now)
            inbox = {each: some for each, some in inbox.items() if len(some) > place + 1}
            if not inbox:
                break
        return inbox

    def _read_later(self, rest: _Inbox) -> None:
        """Keep what is left of a turn for the next one, and read no more of those who sent it."""
        for connection in [each for each in self._unread if each not in rest]:
            self._unread.pop(connection).resume_reading()
        for connection in rest:
            waker = self._wakers.get(connection)
            if waker is not None and connection not in self._unread:
                transport = self._unread[connection] = waker.websocket.transport
                transport.pause_reading()
        if rest:
            self._inbox = rest
            self.after_turn_soon()

    async def _read(self, websocket: RelaySocket, connection: Connection) -> None:
        """Feed the hub with what came the long way, and tell it how the websocket ended."""
        try:
            while True:
                data = await websocket.recv()
                self._release(connection.room, sends=True)
                self._hub.receive(connection, data, self._now())
                self.after_events()
                # recv() does not yield while messages are queued. The writers get their turn first:
                # else a flood starves them, and two frames that came together replace each other
                # although their receivers are not slow.
                await asyncio.sleep(0)
        except ConnectionClosed:
            self._release(connection.room, sends=True)
            code = websocket.close_code or CloseCode.CONNECTION_LOST
            self._hub.disconnect(connection, code, websocket.close_reason or "", self._now())
            self.after_events()

    async def _write(self, websocket: RelaySocket, connection: Connection, waker: "_Waker") -> None:
        """Send what could not be sent at once, and the goodbye."""
        hub = self._hub
        try:
            while True:
                if waker.under_way is not None:
                    await websocket.drain()
                    hub.sent(connection, waker.under_way, self._now())
                    waker.under_way = None
                while (message := self._next_message(connection)) is not None:
                    await websocket.send(message.data)
                    hub.sent(connection, message, self._now())
                if connection.closed is not None:
                    websocket.close_timeout = self._close_timeout_s()
                    await websocket.close(connection.closed.code, connection.closed.reason)
                    return
                await waker.wait()
        except ConnectionClosed:
            return

    def _next_message(self, connection: Connection) -> OutboundMessage | None:
        """Take what a slow connection gets next, if it is due."""
        now = self._now()
        due_s = connection.outbox.due_s(now)
        if connection.closed is None and due_s > now:
            self._hub.hold(connection, due_s)
            self._set_timer()
            return None
        return self._hub.take(connection, now)

    def after_events(self) -> None:
        """Send to those who have got something, and set the timer to the next deadline."""
        self._send_all(self._hub.take_ready())
        self._set_timer()

    def _set_timer(self) -> None:
        when = self._hub.next_timer()
        if when != self._timer_s:
            if self._timer is not None:
                self._timer.cancel()
            loop = asyncio.get_running_loop()
            self._timer = None if when is None else loop.call_at(when, self._on_timer)
            self._timer_s = when

    def _send_all(self, connections: Iterable[Connection]) -> None:
        """Send what waits for some as far as the kernel takes it; the rest is for the writers."""
        # Once for every message that goes out: written for speed.
        wakers, now = self._wakers, self._now()
        written: list[OutboundMessage] = []
        last, framed = None, b""
        for connection in connections:
            waker = wakers.get(connection)
            if waker is None:
                continue
            outbox = connection.outbox
            if outbox.has_voices and not waker.is_tight:
                waker.tighten()
            is_over = connection.closed is not None
            if not is_over and (due_s := outbox.due_s(now)) > now:
                self._hub.hold(connection, due_s)
                continue
            if waker.is_idle and not is_over:
                message = outbox.take(now)
                if message is not None:
                    if message is not last:  # many get the very same
                        last, framed = message, websocket_message(message.data)
                    if waker.websocket.write(framed):
                        written.append(message)
                    else:
                        self._hub.is_sending(connection, now)
                        outbox.note_full(now)
                        waker.under_way = message
                        waker.wake()
                if not outbox.is_waiting:
                    continue
            waker.wake()
            if is_over:
                waker.cut_after(self._close_timeout_s())
        self._hub.all_sent(written, self._now())

    def _on_timer(self) -> None:
        # A loop may fire a timer up to its clock's resolution too early; a deadline that is not met
        # then would be set again and again without the clock moving on.
        due = self._timer_s or 0.0
        self._timer = self._timer_s = None
        self._hub.handle_timer(max(self._now(), due))
        self.after_events()

    def _close_timeout_s(self) -> float:
        """How long a peer may take to read the rest and to close."""
        if self._drain_ends_s is None:
            return self._config.close_timeout_s
        # Nobody needs the place, and what waits for a slow reader is to reach it.
        return max(self._drain_ends_s - self._now(), self._config.close_timeout_s)


class _Waker:
    """Wakes one writer, and cuts the socket of a peer that does not let us close it in time.

    Attributes:
        is_tight: Whether the kernel keeps no more than voices can wait for.
        under_way: Written by somebody else, and not taken by the kernel yet.
    """

    def __init__(self, websocket: RelaySocket) -> None:
        self.websocket = websocket
        self.is_idle = False
        self.under_way: OutboundMessage | None = None
        self._event = asyncio.Event()
        self.is_tight = False
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

    def tighten(self) -> None:
        """Keep less in the kernel from now on: a voice behind it would come late."""
        self.is_tight = True
        _bound_unsent(self.websocket, _VOICE_UNSENT_BYTES)

    def cancel_cut(self) -> None:
        if self._cut is not None:
            self._cut.cancel()


def _bound_unsent(websocket: ServerConnection, unsent_bytes: int) -> None:
    if hasattr(socket, "TCP_NOTSENT_LOWAT"):
        sock = websocket.transport.get_extra_info("socket")
        set_tcp_option(sock, socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, unsent_bytes)
