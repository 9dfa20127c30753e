"""One simulated peer: a real websocket over TCP with as little of a client around it as possible.

A client of the usual kind costs more for a message than the relay does, and would measure itself.
So handshake and control messages go the usual way (the websockets library without its loop, the
session of `pica_protocol`), while media is written and read here, by hand:

- a frame goes out in a websocket message of its own with a masking key of zeros. Valid, and the
  relay unmasks it as any other; random keys are for the protection of proxies (RFC 6455 10.3);
- of a message that comes in, the frames' headers are walked, the payloads are not looked at.

No event loop: `swarm` calls `on_readable` when the socket is.
"""

import random
import socket
import ssl
import struct
from typing import Final

from websockets.client import ClientProtocol
from websockets.typing import Subprotocol
from websockets.uri import parse_uri

from pica_client.bench.relay.tally import Tally
from pica_client.bench.relay.traffic import LARGEST_FACE_BYTES, VOICE_PAYLOAD, Traffic
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
_VOICE: Final = Track(kind="voice", policy="ordered", deadline_ms=200)
_READ_BYTES: Final = 65_536
_OUT = struct.Struct(">IBHHI")
"""A mask of zeros, kind of the message, header of the frame."""
_IN = struct.Struct(">HHI")
_BINARY, _CLOSE, _PING, _PONG = 2, 8, 9, 10
_FIN = 0x80
_MASK = 0x80


class SwarmPeer:
    """One connection, from the first byte to the last.

    Attributes:
        is_live: Whether it is in the room and media may flow.
        is_closed: Whether it is over.
    """

    def __init__(
        self,
        url: str,
        room: str,
        name: str,
        rng: random.Random,
        tally: Tally,
        now: float,
        *,
        has_voice: bool,
    ) -> None:
        """Connect, and ask for the websocket.

        Raises:
            RelayUnreachableError: Nobody listens there.
        """
        self.is_live = self.is_closed = False
        self._tally = tally
        self._traffic = Traffic(rng)
        self._stream = self._voice_stream = self._voice_sequence = 0
        self._rest = b""
        self._unsent = b""
        self._session = ClientSession(
            room=room,
            name=name,
            tracks=(Track(kind="load"), _VOICE)[: 1 + has_voice],
            now=now,
            timeout_s=JOIN_TIMEOUT_S,
        )
        self.sock = _connect(url)
        self._handshake: ClientProtocol | None = ClientProtocol(
            parse_uri(url), subprotocols=[Subprotocol(SUBPROTOCOL)]
        )
        self._handshake.send_request(self._handshake.connect())
        self._write(b"".join(self._handshake.data_to_send()))

    def send_frame(self, now_us: int) -> bool:
        """Send the next frame; False when the network does not take it, and it is dropped."""
        return self._send(self._stream, *self._traffic.next_frame(), now_us)

    def send_voice(self, now_us: int) -> bool:
        """Send the next packet of the voice; False as `send_frame`."""
        sequence = self._voice_sequence
        self._voice_sequence = (sequence + 1) & 0xFFFF
        return self._send(self._voice_stream, sequence, VOICE_PAYLOAD, now_us)

    def _send(self, stream: int, sequence: int, payload: bytes, now_us: int) -> bool:
        size = len(payload)
        length = 1 + HEADER_BYTES + size
        begin = bytes((_FIN | _BINARY, _MASK | min(length, 126)))
        if length >= 126:
            begin += length.to_bytes(2, "big")
        word = now_us // TICK_US % TICK_MODULUS << LENGTH_BITS | size
        head = begin + _OUT.pack(0, MEDIA_KIND, stream, sequence, word)
        if self._unsent:
            self._write(b"")
            if self._unsent:
                return False
        return self._write(head + payload, may_drop=True)

    def on_readable(self, now: float) -> None:
        """Read what has come."""
        self._read(now)
        # What TLS has decrypted already makes no socket readable.
        while isinstance(self.sock, ssl.SSLSocket) and not self.is_closed and self.sock.pending():
            self._read(now)

    def _read(self, now: float) -> None:
        try:
            data = self.sock.recv(_READ_BYTES)
        except (BlockingIOError, InterruptedError, ssl.SSLWantReadError):
            return
        except OSError:
            data = b""
        if not data:
            self._end(1006)
        elif self._handshake is not None:
            self._shake_hands(self._handshake, data, now)
        else:
            self._tally.heard(len(data))
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
                tally, unpack, at = self._tally, _IN.unpack_from, begin + 1
                now_us = tally.now_us
                now_tick = now_us // TICK_US
                received, received_voice = tally.received, tally.received_voice
                while at < end:
                    _, _, word = unpack(data, at)
                    payload_bytes = word & LENGTH_MASK
                    # On one clock, and never a wrap under way.
                    captured_us = (
                        now_us - (now_tick - (word >> LENGTH_BITS)) % TICK_MODULUS * TICK_US
                    )
                    if payload_bytes > LARGEST_FACE_BYTES:
                        received_voice(captured_us)
                    else:
                        received(captured_us)
                    at += HEADER_BYTES + payload_bytes
            else:
                self._take(first, data[begin:end], now)
                if self.is_closed:
                    return
            start = end
        self._rest = data[start:]

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
                    self._stream, self._voice_stream = (
                        event.tracks[0].stream,
                        event.tracks[-1].stream,
                    )
                    self.is_live = True
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
        except (BlockingIOError, InterruptedError, ssl.SSLWantWriteError):
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
        if uri.secure:
            sock = ssl.create_default_context().wrap_socket(sock, server_hostname=uri.host)
    except OSError as error:
        raise RelayUnreachableError(
            f"nobody answers at {url}: {error.strerror or error}; start one with: pica relay"
        ) from error
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if hasattr(socket, "TCP_NOTSENT_LOWAT"):  # as a client does: what waits there is stale
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, MAX_UNSENT_BYTES)
    sock.setblocking(False)
    return sock
