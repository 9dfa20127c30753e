"""The relay's websocket: the library's, with a short way through it for small messages.

The library takes every message through a parser, a queue and a task, on the way out through another
task: 20 to 25 microseconds of processor time each way, however small it is. Nearly all messages of
a relay are a few dozen bytes, whole in one read. Those are unmasked and handed over at once, and
what goes out is written at once while the kernel takes it. All else goes the library's way:
handshakes, long, incomplete or fragmented messages, text, pings, closing, and all that is wrong.

Order is kept. The short way is left while the library holds part of a frame, and what it has put
together itself is handed over from here. Once a message waits in ``recv``, as the parts of a
fragmented one do, that connection stays on the library's way.

What the library leaves without a limit has one here: the bytes of a request before it is a
websocket; pings, which it answers by itself, and fragments; and the time that a peer may keep the
socket open after the library has given it up.

It relies on details of the library that its documentation does not promise: ``protocol.parser`` and
``process_event``. tests/server/net/test_socket.py is there to notice when they change.
"""

import asyncio
import socket
import ssl
import struct
import sys
from asyncio import sslproto
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import Event, State
from websockets.streams import StreamReader

try:
    from websockets.speedups import apply_mask
except ImportError:  # the library was installed without its C extension
    from websockets.utils import apply_mask

from pica_protocol.errors import CloseCode
from pica_protocol.limits import bound_tls_buffer
from pica_server.limits import (
    PROXY_HEADERS,
    Network,
    SocketGuard,
    TokenBucket,
    address_group,
    client_of,
    is_in,
    names_this_machine,
)
from pica_server.net.line import Line
from pica_server.stats import RelayStats

_WHOLE_BINARY: Final = 0x82
"""First byte of a message: the last part of it, and binary (RFC 6455 5.2)."""
_MASKED: Final = 0x80
_HEADER_BYTES: Final = 6
_SHORT_BYTES: Final = 126
_LONGEST_BYTES: Final = 1024
"""Messages up to it come the short way (chosen: whole in one read)."""
_DATA = (Opcode.BINARY, Opcode.TEXT, Opcode.CONT)

_TLS_READ_BYTES: Final = 32_768
"""What TLS reads at once (chosen: a record has 16 KiB at most; asyncio's own 256 KiB are held by
every connection)."""
_READ: Final = Request("", Headers())
"""Stands for a request that was answered."""

MAX_REQUEST_BYTES: Final = 16_384
"""Until it is a websocket (chosen: twice what common servers read). The library would keep 128
lines of 8 KiB of each of them."""
EXTRA_FRAMES_PER_S: Final = 20.0
EXTRA_FRAMES_BURST: Final = 100.0
"""Pings, pongs and fragments, which no other limit sees (chosen: a ping a second is usual)."""

_ASK_BYTES, ASK_S = 1024, 0.01
"""After how many bytes, and how often while it is full, a line is looked at (chosen)."""
_TCP_INFO: Final = struct.Struct("=120xQ16xII48xQQ")
"""Of Linux's ``tcp_info``: bytes acknowledged, bytes not sent yet, the fastest round trip in
microseconds, bytes sent, bytes sent again."""


def set_tcp_option(sock: socket.socket | None, level: int, option: int, value: int) -> None:
    """Set an option of a socket, if that is one of TCP."""
    if sock is not None and sock.family in (socket.AF_INET, socket.AF_INET6):
        with suppress(OSError):  # the peer may be gone already; the reader will find out
            sock.setsockopt(level, option, value)


class _GoneTransport(asyncio.Transport):
    """Stands for a transport that has ended. asyncio's own may raise when it is ended again,
    as the library does when it is late to notice."""

    def is_closing(self) -> bool:
        """Say that it is."""
        return True

    def get_write_buffer_size(self) -> int:
        """Return that nothing waits."""
        return 0

    def write(self, *_: object) -> None:
        """Do nothing more."""

    abort = close = pause_reading = resume_reading = write


class RelaySocket(ServerConnection):
    """A websocket that is counted from its first moment, and cut at once if it is one too many.

    Attributes:
        silent: Those of the relay that are admitted and have not asked for anything yet; it keeps
            itself in there.
        proxies: Addresses whose forwarded headers are trusted.
        address: The client's, see `proxies.address_group`.
        is_local: Whether it comes from this machine, not through a proxy, and asks for this machine
            by a name that no stranger's name server can have made.
        is_misnamed: Whether it asks for another host than this machine, and no proxy of ours does.
        direct_from: The address that it comes from; empty: through a proxy.
        tls: With what it speaks TLS, or None.
        writer: The task that writes to it while it is slow, or closes it; it waits for has_more.
        handshake_timeout_s: Until when it must be a websocket, or be taken for a download. Not the
            library's ``open_timeout``: that one holds until all of an HTTP answer is gone.
    """

    guard: SocketGuard
    stats: RelayStats
    silent: "set[RelaySocket]"
    proxies: Sequence[Network] = ()
    address = ""
    is_local = is_misnamed = False
    direct_from = ""
    _counted_as = ""
    writer: asyncio.Task[None] | None = None
    has_more: asyncio.Event
    handshake_timeout_s: float
    _deadline: asyncio.TimerHandle | None = None
    _is_admitted = _is_opened = _is_open = False
    _on_messages: Callable[[list[bytes]], None] | None = None
    _uses_recv = False
    _is_between_frames = False
    _num_request_bytes = 0
    _extra_frames: TokenBucket
    _cut: asyncio.TimerHandle | None = None
    tls: ssl.SSLContext | None = None
    _tls_task: asyncio.Task[None] | None = None
    _has_begun = _has_early_end = False
    _early: bytearray
    _unasked_bytes = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Let the guard decide, and TLS begin, if there is any."""
        peername = transport.get_extra_info("peername")
        peer = str(peername[0]) if peername else ""
        self.is_local = not address_group(peer)
        self.direct_from = peer
        # Of whom a proxy speaks is not known yet; all the proxy's sockets are not one client's.
        self._counted_as = "" if is_in(peer, self.proxies) else address_group(peer)
        self.address = self._counted_as
        self._is_admitted = self.guard.admit(self._counted_as, self.loop.time())
        if self._is_admitted:
            self.silent.add(self)
        if self.tls is None or not self._is_admitted:
            self._begin(transport)
        else:
            assert isinstance(transport, asyncio.Transport)
            transport.pause_reading()  # what comes now is for TLS
            self._early = bytearray()
            self._tls_task = self.loop.create_task(self._begin_tls(transport, self.tls))

    async def _begin_tls(self, plain: asyncio.Transport, tls: ssl.SSLContext) -> None:
        """Go on when TLS is there; or give up, and free the place."""
        sslproto.SSLProtocol.max_size = _TLS_READ_BYTES
        try:
            transport = await self.loop.start_tls(
                plain,
                self,
                tls,
                server_side=True,
                ssl_handshake_timeout=self.handshake_timeout_s,
                ssl_shutdown_timeout=self.close_timeout,
            )
        except (OSError, RuntimeError, asyncio.CancelledError):  # gone, or the relay is
            transport = None
        if transport is None:
            plain.abort()
            self.silent.discard(self)
            self.guard.closed(self._counted_as, was_opened=False)
            return
        self._begin(transport)
        # With the end of a handshake the first bytes may come, before we are told of that end.
        if early := bytes(self._early):
            self._early.clear()
            self.data_received(early)
        if self._has_early_end:
            self.eof_received()

    def _begin(self, transport: asyncio.BaseTransport) -> None:
        """Take the bytes of the websocket from this transport, or cut one that is too many."""
        self._has_begun = True
        super().connection_made(transport)
        bound_tls_buffer(transport)
        self._line = Line()
        self._extra_frames = TokenBucket(EXTRA_FRAMES_PER_S, EXTRA_FRAMES_BURST, self.loop.time())
        if not self._is_admitted:
            self.stats.limits_hit["sockets"] += 1
            self.transport.abort()
            return
        self._deadline = self.loop.call_later(self.handshake_timeout_s, self.transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell the guard."""
        if not self._has_begun:
            if self._tls_task is not None:
                self._tls_task.cancel()
            return
        super().connection_lost(exc)
        transport = self.transport
        self.transport = _GoneTransport({"peername": transport.get_extra_info("peername")})
        for handle in (self._deadline, self._cut):
            if handle is not None:
                handle.cancel()
        self.silent.discard(self)
        if self._is_admitted:
            self.guard.closed(self._counted_as, was_opened=self._is_opened)
        self._let_go(transport)

    def _let_go(self, transport: asyncio.BaseTransport) -> None:
        """Undo what holds itself, so that the memory of a lost connection comes back at once.

        Else it waits for the garbage collector, which stops everybody while it looks: and thousands
        of strangers a minute make it look often.
        """
        protocol: Any = self.protocol
        protocol.parser.close()
        protocol.__dict__.pop("select_subprotocol", None)
        for error in (protocol.handshake_exc, protocol.parser_exc, self.connection_exc):
            _forget_where(error)
        if hasattr(transport, "_read_ready_cb"):
            transport._read_ready_cb = None

    def give_up(self) -> None:
        """Cut it before it has asked for anything."""
        if self._has_begun:
            self.transport.abort()
        elif self._tls_task is not None:
            self._tls_task.cancel()

    def note_request(self, request: Request) -> None:
        """Note what is requested, and the address of a client behind a proxy."""
        self.silent.discard(self)
        peer, headers = self.direct_from, request.headers
        is_ours = is_in(peer, self.proxies)
        # A web page whose name was made to point here asks from this machine, too.
        names_us = names_this_machine("".join(headers.get_all("Host")))
        self.is_local = self.is_local and names_us
        self.is_misnamed = not (names_us or is_ours)
        if any(name in headers for name in PROXY_HEADERS):
            self.direct_from = ""
            self.is_local = False  # a client elsewhere asks through a proxy on this machine
            hops = headers.get_all("X-Forwarded-For")
            if is_ours and hops:
                self.address = address_group(client_of(peer, hops, self.proxies))

    def note_opened(self) -> None:
        """Take note that this is a websocket now, or a download."""
        if self._deadline is not None:
            self._deadline.cancel()
        self._is_opened = True
        self.request, self.response = _READ, None  # three kilobytes that are read no more
        self._is_open = self.protocol.state is State.OPEN
        self.guard.opened()

    def hand_to(self, on_messages: Callable[[list[bytes]], None]) -> None:
        """Hand whole binary messages to a function as they come, from now on, those that came
        together at once; those that it does not get are in ``recv``."""
        if not self._uses_recv:
            self._on_messages = on_messages

    def data_received(self, data: bytes) -> None:
        """Take what has come: whole short messages here, the rest the library's way."""
        # Once for every message that comes: written for speed.
        at, size = 0, len(data)
        if self._on_messages is not None and self._is_between_frames and self._is_open:
            messages = []
            while size - at > _HEADER_BYTES and data[at] == _WHOLE_BINARY:
                begin = at + _HEADER_BYTES
                length = data[at + 1] - _MASKED
                if length == _SHORT_BYTES and size > begin + 2:  # two bytes of length follow, as a
                    begin += 2  # voice with its face has
                    length = int.from_bytes(data[at + 2 : at + 4], "big")
                    if not _SHORT_BYTES <= length <= _LONGEST_BYTES:
                        break
                elif not 0 <= length < _SHORT_BYTES:
                    break
                end = begin + length
                if end > size:
                    break
                messages.append(apply_mask(data[begin:end], data[begin - 4 : begin]))
                at = end
            if messages:
                self._on_messages(messages)
            if at == size:
                return
        elif not self._is_opened:
            if not self._has_begun:
                self._early += data[: MAX_REQUEST_BYTES + 1 - len(self._early)]
                return
            self._num_request_bytes += size
            if self._num_request_bytes > MAX_REQUEST_BYTES:
                self.stats.limits_hit["request"] += 1
                self.transport.abort()
                return
        was_open = self.state is State.OPEN
        super().data_received(data[at:] if at else data)
        self._is_between_frames = self._awaits_frame()
        if was_open and self.state is not State.OPEN:
            # Who broke a rule may not care to close; till then its face stays, and is frozen.
            self.cut_later(self.close_timeout or 0)

    def cut_later(self, seconds: float) -> None:
        """Cut it if it is not closed by then. The library's own ``close_timeout`` starts only once
        its buffer has drained, and the buffer of a peer that does not read never drains."""
        if self._cut is None:
            self._cut = self.loop.call_later(seconds, self.transport.abort)

    def eof_received(self) -> None:
        """Take note that no more comes."""
        if self._has_begun:
            super().eof_received()
        else:
            self._has_early_end = True

    def send_data(self) -> None:
        """Write what the library has to say in one go: a hundred pongs are one write, and one line
        in the log of asyncio if the socket has died."""
        self._is_open = self.protocol.state is State.OPEN  # to close, it has something to say
        writes = self.protocol.data_to_send()
        if not writes or self.transport.is_closing():
            return
        if data := b"".join(writes):
            self.transport.write(data)
        if writes[-1]:
            return
        # An empty one is the last, and means the end.
        if not self.transport.get_write_buffer_size() and not self.transport.is_closing():
            self.protocol.writes = [b""]
            super().send_data()
        else:
            # Half-closing waits for the rest, and raises into the log if the peer goes till then.
            self.transport.close()

    def process_event(self, event: Event) -> None:
        """Take a message, or a part of one, that the library has read."""
        if isinstance(event, Frame) and event.opcode in _DATA:
            if self._on_messages is not None and event.opcode is Opcode.BINARY and event.fin:
                self._on_messages([bytes(event.data)])
                return
            self._uses_recv, self._on_messages = True, None
        is_extra = isinstance(event, Frame) and (event.opcode not in _DATA or not event.fin)
        is_counted = is_extra and self.state is State.OPEN
        if is_counted and not self._extra_frames.take(self.loop.time()):
            self.stats.limits_hit["extra_frames"] += 1
            self.protocol.fail(CloseCode.TOO_FAST, "too many pings or fragments")
            self.send_data()
        super().process_event(event)

    def _awaits_frame(self) -> bool:
        """Return True if the library holds no part of a frame. Its buffer does not tell: it takes
        the header out before the rest has come."""
        step: Any = self.protocol.parser
        while (inner := step.gi_yieldfrom) is not None:
            step = inner
        return bool(step.gi_code is StreamReader.at_eof.__code__)

    def write(self, framed: bytes) -> bool:
        """Write what `websocket_message` made, if the websocket is open; return whether kernel and
        line took it. If not, or if the socket has died, ``drain``."""
        transport = self.transport
        # More writes before the loop tells us of the end would put a line each into its log.
        if not self._is_open or transport.is_closing():
            return False
        transport.write(framed)
        self._unasked_bytes += len(framed)
        is_line_full = self._unasked_bytes >= _ASK_BYTES and self._is_line_full()
        return not (is_line_full or transport.get_write_buffer_size())

    async def drain(self) -> None:
        """Wait until the kernel has taken what was written, and there is room on the line."""
        await super().drain()
        while self._is_line_full():  # noqa: ASYNC110 - a kernel does not tell when it changes
            await asyncio.sleep(ASK_S)

    def _is_line_full(self) -> bool:
        """Whether `Line.is_full` by what the kernel tells; False where it does not."""
        self._unasked_bytes = 0
        sock = self.transport.get_extra_info("socket")
        if sys.platform != "linux" or sock is None or sock.family == socket.AF_UNIX:
            return False
        try:
            told = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO.size)
            acked, unsent, fastest_us, sent, again = _TCP_INFO.unpack(told)
        except (OSError, struct.error):  # the peer is gone, or the kernel is old
            return False
        return self._line.is_full(acked, sent - again + unsent, fastest_us / 1e6, self.loop.time())


def _forget_where(error: BaseException | None) -> None:
    """Let an error, and those that led to it, hold no frames."""
    while error is not None:
        error.__traceback__ = None
        error = error.__cause__ or error.__context__


def websocket_message(message: bytes) -> bytes:
    """Put a binary message into the form in which a server sends it."""
    size = len(message)
    if size < _SHORT_BYTES:
        header = bytes((_WHOLE_BINARY, size))
    elif size < 65_536:
        header = bytes((_WHOLE_BINARY, _SHORT_BYTES)) + size.to_bytes(2, "big")
    else:
        header = bytes((_WHOLE_BINARY, _SHORT_BYTES + 1)) + size.to_bytes(8, "big")
    return header + message
