"""A pair of asyncio transports with a link in each direction: TCP as a program sees it.

Modelled: write buffers with high and low water marks, a bounded window between the two programs (a
    reader that pauses fills it, and then blocks the writer), half-close, reset, and a network that
    swallows everything without a word (``cut``). See ``bench.impairment`` for what is not.
"""

import asyncio
import socket
from collections import deque
from collections.abc import Callable
from typing import Any

from pica_client.bench.impairment import Way

SEGMENT_BYTES = 1448
"""Payload of one TCP segment on Ethernet."""


class _Ends:
    """As much of a socket as libraries ask for; no kernel is behind it, so it has no options."""

    family = socket.AF_UNIX

    def __init__(self, sockname: Any, peername: Any) -> None:
        self.getsockname = lambda: sockname
        self.getpeername = lambda: peername
        self.fileno = lambda: 0


class SimTransport(asyncio.Transport):
    """One end of a simulated connection."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, out: Way, sockname: Any, peername: Any
    ) -> None:
        ends = _Ends(sockname, peername)
        super().__init__(extra={"sockname": sockname, "peername": peername, "socket": ends})
        self._loop = loop
        self._out = out
        self._protocol: Any = None
        self._peer: SimTransport | None = None
        self._buffer = bytearray()
        self._sent: deque[Callable[[Any], None]] = deque()
        self._under_way = 0
        self._unread: deque[bytes | None] = deque()  # None: end of the stream
        self._high, self._low = 65_536, 16_384
        self._is_reading = True
        self._is_writing_paused = False
        self._is_ending = False  # write_eof or close: the end follows the buffer
        self._has_ended = False
        self._is_closing = False
        self._is_lost = False
        self._is_cut = False

    def connect_to(self, peer: "SimTransport", protocol: asyncio.BaseProtocol) -> None:
        """Tie this end to the other and to the protocol above it."""
        self._peer = peer
        self._protocol = protocol

    def cut(self) -> None:
        """From now on nothing leaves this end, and nobody is told."""
        self._is_cut = True

    def hold(self, until_s: float) -> None:
        """Delay what is written from now on, as an outage does."""
        self._out.free_s = max(self._out.free_s, until_s)

    # What asyncio asks of a transport

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        self._protocol = protocol

    def is_closing(self) -> bool:
        return self._is_closing

    def pause_reading(self) -> None:
        self._is_reading = False

    def resume_reading(self) -> None:
        self._is_reading = True
        self._loop.call_soon(self._deliver)

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._high = high if high is not None else 65_536
        self._low = low if low is not None else self._high // 4

    def get_write_buffer_size(self) -> int:
        return len(self._buffer)

    def write(self, data: Any) -> None:
        if self._is_closing or self._is_ending:
            return
        self._buffer += data
        self._pump()
        if len(self._buffer) > self._high and not self._is_writing_paused:
            self._is_writing_paused = True
            self._protocol.pause_writing()

    def can_write_eof(self) -> bool:
        return True

    def write_eof(self) -> None:
        self._is_ending = True
        self._pump()

    def close(self) -> None:
        if not self._is_closing:
            self._is_closing = self._is_ending = True
            self._is_reading = False
            self._pump()

    def abort(self) -> None:
        self._is_closing = True
        if not self._is_lost:
            self._send(0, lambda peer: peer._lose(ConnectionResetError("reset by peer")))
            self._loop.call_soon(self._lose, None)

    # The network below

    def _send(self, num_bytes: int, arrive: Callable[[Any], None]) -> None:
        if not self._is_cut:
            when = self._out.transmit(num_bytes, self._loop.time())
            self._sent.append(arrive)
            self._loop.call_at(when, self._arrive_next)

    def _arrive_next(self) -> None:
        # First in, first out by itself: asyncio keeps no order among timers of one moment.
        self._sent.popleft()(self._peer)

    def _pump(self) -> None:
        """Put as much of the buffer under way as the window takes, and the end after the last."""
        while self._buffer and self._under_way < self._out.impairment.queue_bytes:
            room = self._out.impairment.queue_bytes - self._under_way
            segment = bytes(self._buffer[: min(SEGMENT_BYTES, room)])
            del self._buffer[: len(segment)]
            self._under_way += len(segment)
            self._send(len(segment), lambda peer, data=segment: peer._arrive(data))
        if self._is_writing_paused and len(self._buffer) <= self._low:
            self._is_writing_paused = False
            self._protocol.resume_writing()
        if self._is_ending and not self._buffer and not self._has_ended:
            self._has_ended = True
            self._send(0, lambda peer: peer._arrive(None))
        if self._is_closing and not self._buffer:
            self._loop.call_soon(self._lose, None)

    def _arrive(self, data: bytes | None) -> None:
        if self._is_lost and data is not None:
            # Bytes for a closed socket: its kernel answers with a reset.
            self._send(0, lambda peer: peer._lose(ConnectionResetError("reset by peer")))
            return
        self._unread.append(data)
        self._deliver()

    def _deliver(self) -> None:
        while self._unread and self._is_reading and not self._is_lost:
            data = self._unread.popleft()
            if data is None:
                if not self._protocol.eof_received():
                    self.close()
            else:
                self._protocol.data_received(data)
                assert self._peer is not None
                self._peer._acknowledge(len(data))

    def _acknowledge(self, num_bytes: int) -> None:
        self._under_way -= num_bytes
        if not self._is_lost:
            self._pump()

    def _lose(self, exc: Exception | None) -> None:
        if not self._is_lost:
            self._is_lost = self._is_closing = True
            self._buffer.clear()
            self._unread.clear()
            self._protocol.connection_lost(exc)
