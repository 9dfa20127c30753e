"""Clients that misbehave, which a relay must outlast.

``python tests/malice/clients.py KIND URL ROOM SECONDS`` does one bad thing to a relay for a bounded
time and prints what became of it as JSON: how often it tried, and the close codes that it saw. A
peer that does not read sees none; the relay's own counters have them. Only for relays of one's own.
"""

import contextlib
import json
import socket
import struct
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, Final
from urllib.parse import urlsplit

from websockets.client import ClientProtocol
from websockets.frames import Frame as WebsocketFrame
from websockets.frames import Opcode
from websockets.typing import Subprotocol
from websockets.uri import parse_uri

from pica_client.bench.relay.peer import CONNECT_TIMEOUT_S
from pica_protocol import SUBPROTOCOL
from pica_protocol.client_session import ClientSession
from pica_protocol.codec import encode_message
from pica_protocol.frames import Frame, encode_frame, media_message
from pica_protocol.messages import Hello, Join, Joined, Track

FLOOD_FPS: Final = 3000.0
"""A hundred times a face's rate."""
SLOW_BPS: Final = 8000
CONNECTS_PER_S: Final = 10_000 / 60
NUM_SOCKETS: Final = 100
"""Sockets that are opened by those who then say nothing, or next to nothing."""
STEP_S: Final = 0.1

_UPGRADE: Final = (
    "GET / HTTP/1.1\r\nHost: relay\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    f"Sec-WebSocket-Key: {'A' * 22}==\r\nSec-WebSocket-Version: 13\r\n"
    f"Sec-WebSocket-Protocol: {SUBPROTOCOL}\r\n\r\n"
).encode()
BOMBS: Final = (
    b"\x01" + b"\x91" * 4000,  # lists in lists
    b"\x01\xdd\xff\xff\xff\xff",  # a list of four thousand million
    b"\x01\xdf\xff\xff\xff\xff",  # a map of as many
    b"\x01\xc6\xff\xff\xff\xff",  # so many bytes
    b"\x01\x81\xdb\xff\xff\xff\xff",  # a map whose key is so long
    b"\x01" + b"\xdc\xff\xff" * 3000,
    b"\x01\xc9\xff\xff\xff\xff\x05",  # an extension type
    b"\x01" + b"\x81\xa1a" * 3000 + b"\xc0",  # maps in maps
)
"""Control messages that are small here and would be large there."""


class MisbehavingClient:
    """A websocket with no manners: a blocking socket, and the library without its loop.

    Attributes:
        sock: The socket.
        code: What it was closed with; None while it is open, 1006 if without a word.
    """

    def __init__(self, url: str, *, receive_buffer_bytes: int | None = None) -> None:
        self.code: int | None = None
        self.sock = connect(url, receive_buffer_bytes)
        self._protocol = ClientProtocol(parse_uri(url), subprotocols=[Subprotocol(SUBPROTOCOL)])
        self._protocol.send_request(self._protocol.connect())
        self._flush()
        while self.code is None and not self._protocol.events_received():
            self._read()

    def join(self, room: str) -> Joined | None:
        """Come into a room; None if we are not let in."""
        track = Track(kind="load")
        now = time.monotonic()
        session = ClientSession(room=room, name="intruder", tracks=(track,), now=now)
        for message in session.messages_to_send(now):
            self.send(message)
        while self.code is None:
            for message in self.received():
                for event in session.receive_data(message, time.monotonic()):
                    if isinstance(event, Joined):
                        return event
        return None

    def send(self, message: bytes) -> None:
        """Send a binary message, however long, for as long as anybody listens."""
        self.send_bytes(WebsocketFrame(Opcode.BINARY, message).serialize(mask=True))

    def send_bytes(self, data: bytes) -> None:
        """Send what may be no websocket message at all."""
        try:
            self.sock.sendall(data)
        except TimeoutError:
            pass
        except OSError:
            self.read_to_end(1.0)
            self.code = self.code or 1006

    def received(self) -> Iterator[bytes]:
        """Read once, and return the messages that this has completed."""
        self._read()
        for event in self._protocol.events_received():
            if isinstance(event, WebsocketFrame) and event.opcode is Opcode.BINARY:
                yield bytes(event.data)

    def read_to_end(self, seconds: float) -> None:
        """Read, as fast as it comes, until we are closed or the time is over."""
        deadline = time.monotonic() + seconds
        while self.code is None and time.monotonic() < deadline:
            self._read()
            self._protocol.events_received()

    def _read(self) -> None:
        self.sock.settimeout(STEP_S)
        try:
            data = self.sock.recv(65_536)
        except TimeoutError:
            return
        except OSError:
            data = b""
        finally:
            self.sock.settimeout(CONNECT_TIMEOUT_S)
        if data:
            self._protocol.receive_data(data)
            self._flush()
        if self._protocol.close_rcvd is not None:
            self.code = self._protocol.close_rcvd.code
        elif not data:
            self.code = 1006

    def _flush(self) -> None:
        with contextlib.suppress(OSError):
            for data in self._protocol.data_to_send():
                if data:
                    self.sock.sendall(data)


def connect(url: str, receive_buffer_bytes: int | None = None) -> socket.socket:
    """Open a TCP connection to a relay."""
    parts = urlsplit(url)
    sock = socket.socket(socket.AF_INET6 if ":" in (parts.hostname or "") else socket.AF_INET)
    sock.settimeout(CONNECT_TIMEOUT_S)
    if receive_buffer_bytes is not None:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer_bytes)
    sock.connect((parts.hostname, parts.port or 80))
    return sock


def stop_reading(url: str, room: str, end_s: float) -> dict[str, Any]:
    """Come into a room, read a little and then nothing more."""
    intruder = MisbehavingClient(url, receive_buffer_bytes=4096)
    intruder.join(room)
    _sleep_until(end_s)
    intruder.read_to_end(5.0)
    return _report(1, [intruder.code])


def read_slowly(url: str, room: str, end_s: float) -> dict[str, Any]:
    """Come into a room and read 8 kbit/s of it."""
    intruder = MisbehavingClient(url, receive_buffer_bytes=4096)
    intruder.join(room)
    num_bytes = 0
    while time.monotonic() < end_s:
        try:
            data = intruder.sock.recv(int(SLOW_BPS / 8 * STEP_S))
        except OSError:
            data = b""
        if not data:
            return _report(1, [1006]) | {"read_bytes": num_bytes}
        num_bytes += len(data)
        time.sleep(STEP_S)
    return _report(1, [None]) | {"read_bytes": num_bytes}


def flood(url: str, room: str, end_s: float) -> dict[str, Any]:
    """Publish at a hundred times the usual rate, again and again."""
    codes: list[int | None] = []
    while time.monotonic() < end_s:
        intruder = MisbehavingClient(url)
        joined = intruder.join(room)
        intruder.sock.setblocking(True)
        begin_s, num_sent = time.monotonic(), 0
        while joined and intruder.code is None and time.monotonic() < end_s:
            while num_sent < (time.monotonic() - begin_s) * FLOOD_FPS and intruder.code is None:
                # Captured at 0, so that nobody takes these for frames of the load.
                frame = Frame(
                    stream=joined.tracks[0].stream,
                    sequence=num_sent % 65_536,
                    captured_us=0,
                    payload=bytes(6),
                )
                intruder.send(media_message([encode_frame(frame)]))
                num_sent += 1
            intruder.read_to_end(0.01)
        codes.append(intruder.code)
        intruder.sock.close()
        time.sleep(0.2)
    return _report(len(codes), codes)


def open_slowly(url: str, room: str, end_s: float) -> dict[str, Any]:
    """Slow loris: handshakes that come a byte at a time."""
    text = f"GET / HTTP/1.1\r\nHost: relay\r\nX-Padding: {'x' * 4000}".encode()
    return _hold_sockets(url, end_s, lambda sock, turn: sock.send(text[turn : turn + 1]))


def say_nothing(url: str, room: str, end_s: float) -> dict[str, Any]:
    """Half-open sockets: some that say nothing, some that are websockets and say nothing."""
    intruders = [MisbehavingClient(url) for _ in range(NUM_SOCKETS // 4)]
    result = _hold_sockets(url, end_s, lambda sock, turn: None)
    for intruder in intruders:
        intruder.read_to_end(0.2)
    codes = [intruder.code for intruder in intruders]
    result["websockets"] = _report(len(intruders), codes)["codes"]
    return result


def send_large(url: str, room: str, end_s: float) -> dict[str, Any]:
    """Messages of a megabyte."""
    return _offend(url, room, end_s, [bytes([2]) + bytes(1_000_000)])


def send_bombs(url: str, room: str, end_s: float) -> dict[str, Any]:
    """Control messages that would be large once they are read."""
    return _offend(url, room, end_s, list(BOMBS))


def connect_often(url: str, room: str, end_s: float) -> dict[str, Any]:
    """Ten thousand connections a minute that each ask for a room of their own, and go."""
    codes: list[int | None] = []
    waiting: list[tuple[float, socket.socket]] = []
    begin_s = time.monotonic()
    while (now := time.monotonic()) < end_s:
        if len(codes) + len(waiting) < (now - begin_s) * CONNECTS_PER_S:
            sock = connect(url)
            sock.sendall(_UPGRADE)
            waiting.append((now, sock))
        else:
            time.sleep(0.002)
        while waiting and now - waiting[0][0] > 0.3:
            codes.append(_ask_and_go(waiting.pop(0)[1], f"{room}-{len(codes)}"))
    for _, sock in waiting:
        sock.close()
    return _report(len(codes) + len(waiting), codes)


def _ask_and_go(sock: socket.socket, room: str) -> int | None:
    """Ask for a room on a socket whose handshake is over; return a close code if one came."""
    messages = (encode_message(Hello(software="x")), encode_message(Join(room=room, name="x")))
    with contextlib.suppress(OSError):
        for message in messages:
            sock.sendall(WebsocketFrame(Opcode.BINARY, message).serialize(mask=True))
        sock.settimeout(0.02)
        data = sock.recv(65_536)
        sock.close()
        at = data.rfind(b"\x88")
        if at >= 0 and len(data) >= at + 4:
            return int(struct.unpack_from(">H", data, at + 2)[0])
    sock.close()
    return None


def _offend(url: str, room: str, end_s: float, messages: list[bytes]) -> dict[str, Any]:
    """Come in, send one of the messages, and again."""
    codes: list[int | None] = []
    while time.monotonic() < end_s:
        intruder = MisbehavingClient(url)
        if intruder.join(f"{room}-side"):
            intruder.send(messages[len(codes) % len(messages)])
            intruder.read_to_end(2.0)
        codes.append(intruder.code)
        intruder.sock.close()
        time.sleep(STEP_S)
    return _report(len(codes), codes)


def _hold_sockets(
    url: str, end_s: float, act: Callable[[socket.socket, int], object]
) -> dict[str, Any]:
    """Open many sockets and hold them; count those that the relay cuts."""
    sockets = [connect(url) for _ in range(NUM_SOCKETS)]
    for sock in sockets:
        sock.setblocking(False)
    num_cut, turn = 0, 0
    while time.monotonic() < end_s:
        for sock in list(sockets):
            try:
                act(sock, turn)
                is_open = bool(sock.recv(4096))  # an answer: HTTP, that we are too slow
            except BlockingIOError:
                is_open = True
            except OSError:
                is_open = False
            if not is_open:
                num_cut += 1
                sockets.remove(sock)
                sock.close()
        turn += 1
        time.sleep(STEP_S)
    return {"attempts": NUM_SOCKETS, "codes": {}, "cut": num_cut}


def _report(attempts: int, codes: list[int | None]) -> dict[str, Any]:
    seen = Counter("none" if code is None else str(code) for code in codes)
    return {"attempts": attempts, "codes": dict(seen)}


def _sleep_until(when_s: float) -> None:
    time.sleep(max(when_s - time.monotonic(), 0.0))


KINDS: Final[dict[str, Callable[[str, str, float], dict[str, Any]]]] = {
    "stopped-reader": stop_reading,
    "slow-reader": read_slowly,
    "flood": flood,
    "slow-loris": open_slowly,
    "half-open": say_nothing,
    "large-messages": send_large,
    "bombs": send_bombs,
    "connects": connect_often,
}


def main() -> None:
    """Offend, and report."""
    kind, url, room, seconds = sys.argv[1:]
    result = KINDS[kind](url, room, time.monotonic() + float(seconds))
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
