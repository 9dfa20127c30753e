"""What moves between the websockets of a relay and its hub.

What a websocket receives goes to the hub at once. When all sockets that were readable in a turn of
the event loop have been read, who has got something is sent it, so frames that came in one turn
leave in one message. Nothing waits for that until the core is busy for `BUSY_RATIO` of the time;
above that, sending waits for as many milliseconds as keep it there. While kernel and `Line` take
what is sent, that is all. A receiver that reads slowly gets a task of its own, which sends it
what its `Outbox` gives out, and the same task sends the goodbye.

The buffers behind an outbox are kept small, because what they hold can be neither replaced nor
withdrawn: one message in the transport, a bounded socket buffer in the kernel, and on the way what
the line is seen to carry.
"""

import asyncio
import logging
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

from websockets.exceptions import ConnectionClosed

from pica_protocol import SUBPROTOCOL
from pica_protocol.client_session import RIDE_S
from pica_protocol.errors import CloseCode
from pica_protocol.frames import media_message
from pica_server.config import RelayConfig
from pica_server.net.socket import ASK_S, RelaySocket, set_tcp_option, websocket_message
from pica_server.room.hub import Hub
from pica_server.room.outbox import OutboundMessage
from pica_server.room.room import Connection

_SEND_BUFFER_BYTES = 16_384
"""Bytes of one connection that the kernel may hold, and may round up (chosen: what waits there is
stale and cannot be replaced by newer frames)."""
BUSY_RATIO = 0.7
"""Of the time; a core that works for longer sends less often (chosen: the rest is for joins and
bursts)."""
LONGEST_WAIT_S = 0.01
"""How long frames wait for others on a busy core at most (chosen: a third of what a face lasts)."""
_PACE_S = 0.02
"""Between two messages of faces alone to a slow receiver, whose line what surrounds a message would
fill (chosen: less than a face lasts)."""

_logger = logging.getLogger(__name__)


class Pump:
    """Moves messages between websockets and one hub."""

    def __init__(self, hub: Hub, config: RelayConfig) -> None:
        self._hub = hub
        self._config = config
        self._all_gone = asyncio.Event()
        self._drain_ends_s: float | None = None
        self._websockets: set[RelaySocket] = set()
        self._now: Callable[[], float] = time.monotonic
        self._soon: asyncio.Handle | None = None
        self._wait_s = 0.0

    def start(self) -> None:
        """Take the time from the running loop from now on."""
        self._now = asyncio.get_running_loop().time

    def stop(self) -> None:
        """Do nothing more; all websockets have ended."""
        if self._soon is not None:
            self._soon.cancel()

    async def drain(self, longest_s: float) -> None:
        """Send everybody away in good order, and return when they are gone, or it is late."""
        self._drain_ends_s = self._now() + longest_s
        self._all_gone.clear()
        self._hub.drain(self._now())
        self.send_all()
        if self._websockets:
            with suppress(TimeoutError):
                async with asyncio.timeout(longest_s):
                    await self._all_gone.wait()

    def cut(self) -> None:
        """Cut every websocket without another word."""
        for websocket in self._websockets:
            websocket.transport.abort()

    async def serve(self, websocket: RelaySocket) -> None:
        """Serve one websocket of a call until it has ended."""
        sock = websocket.transport.get_extra_info("socket")
        set_tcp_option(sock, socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        hub, began_s = self._hub, self._now()
        connection = hub.connect(began_s, websocket.address)
        connection.shell = websocket
        self._websockets.add(websocket)
        try:
            if websocket.subprotocol is None:
                reason = f"this relay speaks {SUBPROTOCOL}"
                hub.connections.close(connection, CloseCode.WRONG_VERSION, reason, self._now())
            self.send_all()
            websocket.hand_to(partial(self._on_messages, connection))
            while True:  # what does not come the short way
                self._on_messages(connection, [await websocket.recv()])
                # recv() does not yield while messages are queued.
                await asyncio.sleep(0)
        except ConnectionClosed:
            code = websocket.close_code or CloseCode.CONNECTION_LOST
            hub.disconnect(connection, code, websocket.close_reason or "", self._now())
            if websocket.writer is not None:
                await asyncio.wait([websocket.writer])
        finally:
            if websocket.writer is not None:
                websocket.writer.cancel()
            hub.disconnect(connection, CloseCode.INTERNAL_ERROR, "", self._now())
            connection.shell = None
            self._websockets.remove(websocket)
            self.send_all()
            self._log_closed(connection, began_s)
            if not self._websockets:
                self._all_gone.set()

    def _log_closed(self, connection: Connection, began_s: float) -> None:
        if not connection.has_joined:  # strangers come by the thousand; metrics count them
            return
        closed = connection.closed
        code = CloseCode.INTERNAL_ERROR if closed is None else closed.code
        fields = {
            "connection": connection.serial,
            "code": int(code),
            "by_peer": closed is not None and closed.is_remote,
            "seconds": round(self._now() - began_s, 3),
        }
        _logger.info("connection closed", extra=fields)

    def _on_messages(self, connection: Connection, messages: Sequence[bytes | str]) -> None:
        """Feed the hub with what one websocket has received."""
        hub, now = self._hub, self._now()
        try:
            hub.receive(connection, messages, now)
        except Exception:  # a fault of ours; it must not cost anybody else anything
            _logger.exception("connection failed", extra={"connection": connection.serial})
            hub.connections.close(connection, CloseCode.INTERNAL_ERROR, "relay fault", now)
        self.after_turn_soon()

    def note_work(self, busy_ratio: float) -> None:
        """Take note of for how much of the time since the last call the core was busy."""
        wait_s = self._wait_s + (busy_ratio - BUSY_RATIO) * LONGEST_WAIT_S
        self._wait_s = min(max(wait_s, 0.0), LONGEST_WAIT_S)

    def after_turn_soon(self) -> None:
        """See to it that what has come in this turn is sent when it is over."""
        if self._soon is None:
            loop = asyncio.get_running_loop()
            if self._wait_s:
                self._soon = loop.call_later(self._wait_s, self._after_turn)
            else:
                self._soon = loop.call_soon(self._after_turn)

    def _after_turn(self) -> None:
        self._soon = None
        self.send_all()

    def send_all(self) -> None:
        """Send what waits as far as the kernel takes it; the rest is for the writers."""
        # Once for every message that goes out: written for speed.
        now = self._now()
        oldest_s = now
        num_messages = num_bytes = num_frames = 0
        for connection in self._hub.take_ready():
            websocket: RelaySocket | None = connection.shell
            if websocket is None:
                continue
            outbox = connection.outbox
            under_way: OutboundMessage | None = None
            if outbox.is_quick and websocket.writer is None:  # nearly always
                frames = outbox.fresh
                if not frames:
                    continue
                outbox.fresh = []
                frame, num = frames[0], len(frames)
                if num > 1:
                    framed = websocket_message(media_message([each.data for each in frames]))
                elif not (framed := frame.framed):
                    framed = frame.framed = websocket_message(media_message((frame.data,)))
                if websocket.write(framed):
                    num_messages += 1
                    num_bytes += len(framed)
                    num_frames += num
                    if frame.received_s < oldest_s:
                        oldest_s = frame.received_s
                    continue
                under_way = OutboundMessage(framed, num, frame.received_s)
            elif websocket.writer is None and connection.closed is None and not outbox.is_slow(now):
                while (message := outbox.take(now)) is not None:
                    if not websocket.write(websocket_message(message.data)):
                        under_way = message
                        break
                    self._hub.sent(connection, message, now)
                if under_way is None:
                    continue
            if under_way is not None:
                self._hub.is_sending(connection, now)
            if websocket.writer is None:
                websocket.has_more = asyncio.Event()
                write = self._write(websocket, connection, under_way)
                websocket.writer = asyncio.get_running_loop().create_task(write)
            websocket.has_more.set()
            if connection.closed is not None:
                websocket.cut_later(self._close_timeout_s())
        if num_messages:
            self._hub.stats.note_sent(num_messages, num_bytes, num_frames, self._now() - oldest_s)

    async def _write(
        self, websocket: RelaySocket, connection: Connection, under_way: OutboundMessage | None
    ) -> None:
        """Send a slow receiver what could not be sent at once, and everybody the goodbye."""
        hub, outbox, has_more = self._hub, connection.outbox, websocket.has_more
        voice_s = self._now()
        try:
            if under_way is not None:
                await websocket.drain()
                hub.sent(connection, under_way, self._now())
            while True:
                has_more.clear()
                is_voice, began_s = outbox.is_urgent, self._now()
                if (message := hub.take(connection, began_s)) is not None:
                    await websocket.send(message.data)
                    if (now := self._now()) - began_s >= ASK_S:
                        outbox.note_full(now)
                    hub.sent(connection, message, now)
                    voice_s = now if is_voice else voice_s
                    if connection.closed is not None:
                        continue
                elif connection.closed is not None:
                    websocket.close_timeout = self._close_timeout_s()
                    await websocket.close(connection.closed.code, connection.closed.reason)
                    return
                elif not outbox.is_slow(self._now()):
                    return
                if not outbox.is_waiting:
                    await has_more.wait()
                # During speech, faces share the messages of the voice.
                pace_s = RIDE_S if self._now() - voice_s < 2 * RIDE_S else _PACE_S
                with suppress(TimeoutError):
                    async with asyncio.timeout(pace_s):
                        while not outbox.is_urgent and connection.closed is None:
                            has_more.clear()
                            await has_more.wait()
        except (ConnectionClosed, OSError):  # the latter of a reset while the buffer drains
            return
        finally:
            websocket.writer = None

    def _close_timeout_s(self) -> float:
        """How long a peer may take to read the rest and to close."""
        if self._drain_ends_s is None:
            return self._config.close_timeout_s
        # The place is not needed, and what waits for a slow reader is to reach it.
        return max(self._drain_ends_s - self._now(), self._config.close_timeout_s)
