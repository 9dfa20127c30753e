"""What the load generator can do at most: a server that costs next to nothing.

``python tests/rivals/echo.py COPIES FRAMES_PER_MESSAGE`` lets everybody in and sends
every frame back to its sender, as many copies as other peers would get, so many in a message. No
rooms, no queues, no limits: a relay that comes near these figures has reached the generator's, not
its own.
"""

import contextlib
import select
import socket
import sys
import time
from typing import Final

from websockets.http11 import Request
from websockets.server import ServerProtocol
from websockets.typing import Subprotocol

from pica_protocol import SUBPROTOCOL
from pica_protocol.messages import Join, Joined
from pica_protocol.server_session import ServerSession

_HEAD_BYTES: Final = 7
"""Websocket header and mask of a short message, and the kind of the message."""


class _Echo:
    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.is_joined = False
        self._handshake: ServerProtocol | None = ServerProtocol(
            subprotocols=[Subprotocol(SUBPROTOCOL)]
        )
        self._session = ServerSession(now=0.0)

    def on_data(self, data: bytes) -> None:
        """Let the peer in."""
        handshake = self._handshake
        if handshake is not None:
            handshake.receive_data(data)
            for request in handshake.events_received():
                if isinstance(request, Request):
                    handshake.send_response(handshake.accept(request))
                    self.sock.sendall(b"".join(handshake.data_to_send()))
                    self._handshake = None
            return
        while data:  # Hello and Join, short messages of one read each or both in one
            length = data[1] & 0x7F
            begin = 6 if length < 126 else 8
            if length == 126:
                length = data[2] << 8 | data[3]
            message, data = data[begin : begin + length], data[begin + length :]
            for event in self._session.receive_data(message, time.monotonic()):
                if isinstance(event, Join):
                    tracks = tuple(
                        type(track)(kind=track.kind, stream=index + 1)
                        for index, track in enumerate(event.tracks)
                    )
                    self._session.accept(Joined(room=event.room, peer_id="p1", tracks=tracks))
                    self.is_joined = True
            for answer in self._session.messages_to_send(time.monotonic()):
                self.sock.sendall(_framed(answer))


def main() -> None:
    """Echo until standard input ends."""
    copies, per_message = int(sys.argv[1]), int(sys.argv[2])
    listener = socket.create_server(("127.0.0.1", 0), backlog=1024)
    poller = select.poll()
    poller.register(sys.stdin.fileno(), select.POLLIN)
    poller.register(listener.fileno(), select.POLLIN)
    peers: dict[int, _Echo] = {}
    print(f"ws://127.0.0.1:{listener.getsockname()[1]}", flush=True)
    while True:
        for fd, _ in poller.poll():
            peer = peers.get(fd)
            if peer is None:
                if fd == sys.stdin.fileno():
                    return
                sock, _ = listener.accept()
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                peers[sock.fileno()] = _Echo(sock)
                poller.register(sock.fileno(), select.POLLIN)
                continue
            data = b""
            with contextlib.suppress(OSError):
                data = peer.sock.recv(65_536)
            if not data:
                poller.unregister(fd)
                peers.pop(fd).sock.close()
            elif not peer.is_joined:
                peer.on_data(data)
            else:
                _echo(peer.sock, data, copies, per_message)


def _echo(sock: socket.socket, data: bytes, copies: int, per_message: int) -> None:
    """Send each frame of some whole short messages back, without their mask of zeros."""
    while len(data) > _HEAD_BYTES:
        end = 6 + (data[1] & 0x7F)
        body = b"\x02" + data[_HEAD_BYTES:end] * per_message
        message = _framed(body)
        with contextlib.suppress(OSError):
            for _ in range(copies // per_message):
                sock.send(message)
        data = data[end:]


def _framed(body: bytes) -> bytes:
    """Put a binary message of less than 64 KiB into websocket form."""
    size = len(body)
    return bytes((0x82, size) if size < 126 else (0x82, 126, size >> 8, size & 0xFF)) + body


if __name__ == "__main__":
    main()
