"""One simulated peer: a real websocket over TCP with as little of a client around it as possible.

A client of the usual kind costs more for a message than the relay does, and would measure itself.
So handshake and control messages go the usual way (the websockets library without its loop, the
session of `pica_protocol`), while media is written and read here, by hand:

- a frame goes out in a websocket message of its own with a masking key of zeros. Valid, and the
  relay unmasks it as any other; random keys are for the protection of proxies (RFC 6455 10.3);
- of a message that comes in, the frames' headers are walked, the payloads are not looked at.

Payloads are noise with the sizes of a coded face. Unlike a real sender this one never falls silent.
No event loop: `bench.Swarm` calls `on_readable` when the socket is.
"""

import random
import socket
import struct
import time
from array import array
from collections import Counter
from collections.abc import Sequence
from typing import Final

from websockets.client import ClientProtocol
from websockets.typing import Subprotocol
from websockets.uri import parse_uri

from pica_client.errors import RelayUnreachableError
from pica_client.transport.connect import MAX_UNSENT_BYTES
from pica_protocol import SUBPROTOCOL
from pica_protocol.client_session import ClientSession
from pica_protocol.frames import (
    HEADER_BYTES,
    LENGTH_BITS,
    LENGTH_MASK,
    MEDIA_KIND,
    TICK_MODULUS,
    TICK_US,
)
from pica_protocol.messages import Joined, Track
from pica_protocol.session import State

CONNECT_TIMEOUT_S: Final = 5.0
JOIN_TIMEOUT_S: Final = 10.0
SIZES: Final[Sequence[int]] = (2, 13, 16, 17, 19, 20, 21, 22, 24, 26, 37)
"""Payload bytes of the shipped performance "talk" at the default quality: minimum, deciles and
maximum (measured)."""
_READ_BYTES: Final = 65_536
_OUT = struct.Struct(">IBHHI")
"""A mask of zeros, kind of the message, header of the frame."""
_IN = struct.Struct(">HHI")
_BINARY, _CLOSE, _PING, _PONG = 2, 8, 9, 10
_FIN = 0x80
_MASK = 0x80


class Tally:
    """Counts of the frames captured between two moments, for all peers of a process.

    Attributes:
        now_us: When the last read was, in whole ticks of the wire.
        delays_us: Of each frame received, from capture to receipt.
        codes: Websocket close codes of connections that the relay ended.
    """

    def __init__(self) -> None:
        self.begin_us = self.end_us = self.now_us = 0
        self.sent = 0
        self.delays_us = array("q")
        self.codes: Counter[int] = Counter()

    def count_received(self, captured_us: int) -> None:
        """Count a frame as of the last read."""
        if self.begin_us <= captured_us < self.end_us:
            self.delays_us.append(self.now_us - captured_us)


class SwarmPeer:
    """One connection, from the first byte to the last.

    Attributes:
        is_live: Whether it is in the room and media may flow.
        is_closed: Whether it is over.
        stream: Number of its track.
    """

    def __init__(self, url: str, room: str, name: str, rng: random.Random, tally: Tally) -> None:
        """Connect, and ask for the websocket.

        Raises:
            RelayUnreachableError: Nothing listens there.
        """
        self.is_live = self.is_closed = False
        self._tally, self._rng = tally, rng
        self._noise = rng.randbytes(max(SIZES))
        self.stream = self._sequence = 0
        self._rest = self._unsent = b""
        self._session = ClientSession(
            room=room,
            name=name,
            tracks=(Track(kind="load"),),
            now=time.monotonic(),
            timeout_s=JOIN_TIMEOUT_S,
        )
        self.sock = _connect(url)
        self._handshake: ClientProtocol | None = ClientProtocol(
            parse_uri(url), subprotocols=[Subprotocol(SUBPROTOCOL)]
        )
        self._handshake.send_request(self._handshake.connect())
        self._write(b"".join(self._handshake.data_to_send()))

    def send_frame(self, now_us: int) -> None:
        """Send the next frame, or drop it when the network does not take it."""
        if not self.is_live:
            return
        size = SIZES[int(self._rng.random() * len(SIZES))]
        word = now_us // TICK_US % TICK_MODULUS << LENGTH_BITS | size
        data = bytes((_FIN | _BINARY, _MASK | 1 + HEADER_BYTES + size))
        data += _OUT.pack(0, MEDIA_KIND, self.stream, self._sequence, word) + self._noise[:size]
        self._sequence = (self._sequence + 1) & 0xFFFF
        if self._unsent:
            self._write(b"")
        if not self._unsent and self._write(data, may_drop=True):
            self._tally.sent += self._tally.begin_us <= now_us < self._tally.end_us

    def on_readable(self, now: float) -> None:
        """Read what has come."""
        try:
            data = self.sock.recv(_READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data = b""
        if not data:
            self._end(1006)
        elif self._handshake is not None:
            self._shake_hands(self._handshake, data, now)
        else:
            self._tally.now_us = time.monotonic_ns() // 1000 // TICK_US * TICK_US
            self._read_messages(self._rest + data if self._rest else data, now)

    def close(self) -> None:
        """Cut the connection."""
        self.is_live, self.is_closed = False, True
        self.sock.close()

    def _shake_hands(self, handshake: ClientProtocol, data: bytes, now: float) -> None:
        handshake.receive_data(data)
        if not handshake.events_received():
            return  # the answer is not complete
        if handshake.handshake_exc is not None:
            self._end(1006)
            return
        self._handshake = None
        self._flush(now)

    def _read_messages(self, data: bytes, now: float) -> None:
        """Take whole websocket messages off the front and keep the rest."""
        start, size = 0, len(data)
        while size - start >= 2:
            first, length = data[start], data[start + 1]
            begin = start + 2
            if length == 126:
                if size - start < 4:
                    break
                length = data[start + 2] << 8 | data[start + 3]
                begin = start + 4
            elif length > 126:
                self._end(1009)  # a message of 64 KiB: no relay of ours sends that
                return
            end = begin + length
            if end > size:
                break
            if first == _FIN | _BINARY and length and data[begin] == MEDIA_KIND:
                self._count_frames(data, begin + 1, end)
            else:
                self._take(first, data[begin:end], now)
                if self.is_closed:
                    return
            start = end
        self._rest = data[start:]

    def _count_frames(self, data: bytes, at: int, end: int) -> None:
        """Walk the headers of a media message. Both ends are on one clock, so none has wrapped."""
        now_us, unpack, count = self._tally.now_us, _IN.unpack_from, self._tally.count_received
        now_tick = now_us // TICK_US
        while at < end:
            word = unpack(data, at)[2]
            count(now_us - (now_tick - (word >> LENGTH_BITS)) % TICK_MODULUS * TICK_US)
            at += HEADER_BYTES + (word & LENGTH_MASK)

    def _take(self, first: int, payload: bytes, now: float) -> None:
        """Take one message that is not media."""
        opcode = first & 0x0F
        if opcode == _PING:
            self._write(bytes((_FIN | _PONG, _MASK | len(payload))) + bytes(4) + payload)
        elif opcode == _CLOSE:
            self._end(int.from_bytes(payload[:2], "big") if len(payload) >= 2 else 1005)
        elif first == _FIN | _BINARY:
            for event in self._session.receive_data(payload, now):
                if isinstance(event, Joined):
                    self.stream, self.is_live = event.tracks[0].stream, True
            self._flush(now)
        elif opcode != _PONG:
            self._end(1002)

    def _flush(self, now: float) -> None:
        """Send what the session has to say."""
        for message in self._session.messages_to_send(now):
            size = len(message)
            length = bytes((_MASK | size,)) if size < 126 else struct.pack(">BH", _MASK | 126, size)
            self._write(bytes((_FIN | _BINARY,)) + length + bytes(4) + message)
        if self._session.state is State.CLOSED:
            self._end(self._session.closed.code if self._session.closed else 1006)

    def _write(self, data: bytes, *, may_drop: bool = False) -> bool:
        data = self._unsent + data
        try:
            sent = self.sock.send(data)
        except (BlockingIOError, InterruptedError):
            sent = 0
        except OSError:
            return True  # the reader finds out
        if sent == 0 and may_drop:
            return False
        self._unsent = data[sent:]
        return True

    def _end(self, code: int) -> None:
        if not self.is_closed:
            self._tally.codes[code] += 1
            self.close()


def _connect(url: str) -> socket.socket:
    uri = parse_uri(url)
    try:
        sock = socket.create_connection((uri.host, uri.port), timeout=CONNECT_TIMEOUT_S)
    except OSError as error:
        raise RelayUnreachableError(
            f"no relay answers at {url}: {error.strerror or error}; start one with: pica relay"
        ) from error
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if hasattr(socket, "TCP_NOTSENT_LOWAT"):  # as a client does: what waits there is stale
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, MAX_UNSENT_BYTES)
    sock.setblocking(False)
    return sock
