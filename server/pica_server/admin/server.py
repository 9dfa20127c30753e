"""The admin's HTTP listener: one request for each connection, and nothing decided here.

It has a port of its own because the websocket library reads nothing but GET, and because an
operator wants to keep it where the public does not come. HTTP itself is read by h11: with limits
of size, time and number on the relay's own loop, a server library leaves no less to write.
"""

import asyncio
import json
import logging
import ssl
from collections.abc import Callable
from http import HTTPStatus
from typing import Final

import h11

from pica_server.admin.admin import Admin, Answer
from pica_server.errors import ListenError

TIMEOUT_S: Final = 5.0
"""Time for a request to come and its answer to go."""
MAX_HEAD_BYTES: Final = 16_384
MAX_REQUEST_BYTES: Final = 32_768
"""Head and body of a request; nothing here needs a body."""
MAX_CONNECTIONS: Final = 32
"""Connections at once; one more is cut."""

_logger = logging.getLogger(__name__)


class AdminServer:
    """Listens for admins."""

    def __init__(self, admin: Admin, after: Callable[[], object]) -> None:
        """Prepare; ``after`` is called after every request, which may have changed something."""
        self._admin = admin
        self._after = after
        self._server: asyncio.Server | None = None
        self._tls: ssl.SSLContext | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def port(self) -> int:
        """The port that it really has."""
        assert self._server is not None, "only while it listens"
        return int(self._server.sockets[0].getsockname()[1])

    async def start(self, host: str, port: int, tls: ssl.SSLContext | None) -> None:
        """Begin to listen.

        Raises:
            ListenError: The address cannot be bound.
        """
        self._tls = tls
        try:
            self._server = await asyncio.start_server(
                self._accept, host, port, limit=MAX_HEAD_BYTES
            )
        except OSError as error:
            raise ListenError(
                f"cannot listen on {host}:{port}: {error.strerror or error}; "
                "choose another --admin-port (0 takes a free one) or --admin-host"
            ) from error

    async def stop(self) -> None:
        """Listen no more, and cut who is still there."""
        if self._server is not None:
            self._server.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._tasks) >= MAX_CONNECTIONS:
            writer.transport.abort()
            return
        task = asyncio.get_running_loop().create_task(self._serve(reader, writer))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with asyncio.timeout(TIMEOUT_S):
                if self._tls is not None:  # not by the server: what shakes hands is counted, too
                    await writer.start_tls(self._tls)
                writer.write(await self._exchange(reader))
                await writer.drain()
                writer.close()
                await writer.wait_closed()
        except (OSError, TimeoutError):
            pass  # whoever asked is gone, or too slow
        except Exception:
            _logger.exception("admin request failed")
        finally:
            writer.transport.abort()

    async def _exchange(self, reader: asyncio.StreamReader) -> bytes:
        """Read one request and return the bytes of the answer."""
        http = h11.Connection(h11.SERVER, max_incomplete_event_size=MAX_HEAD_BYTES)
        try:
            request = await _read_request(http, reader)
        except h11.RemoteProtocolError as error:
            refusal = {"error": "no HTTP request that can be read"}
            return _bytes_of(http, Answer(HTTPStatus(error.error_status_hint), refusal))
        if request is None:
            return b""
        headers = {key.decode("latin-1"): value.decode("latin-1") for key, value in request.headers}
        method, target = request.method.decode("latin-1"), request.target.decode("latin-1")
        answer = self._admin.answer(method, target, headers, asyncio.get_running_loop().time())
        self._after()
        if method != "GET":
            # That it was done; to whom is not for logs.
            _logger.info("admin request", extra={"method": method, "status": int(answer.status)})
        return _bytes_of(http, answer)


async def _read_request(http: h11.Connection, reader: asyncio.StreamReader) -> h11.Request | None:
    """Read a request and its body, which is not used; None if nobody asks for anything."""
    request: h11.Request | None = None
    num_bytes = 0
    while True:
        event = http.next_event()
        if event is h11.NEED_DATA:
            data = await reader.read(4096)
            num_bytes += len(data)
            if num_bytes > MAX_REQUEST_BYTES:
                raise h11.RemoteProtocolError("too long", error_status_hint=413)
            http.receive_data(data)
        elif isinstance(event, h11.Request):
            request = event
        elif isinstance(event, h11.EndOfMessage | h11.ConnectionClosed):
            return request


def _bytes_of(http: h11.Connection, answer: Answer) -> bytes:
    body = json.dumps(answer.body).encode() + b"\n"
    headers = [
        ("Content-Type", "application/json"),
        ("Content-Length", str(len(body))),
        ("Cache-Control", "no-store"),
        ("Connection", "close"),
        *answer.headers,
    ]
    response = h11.Response(status_code=answer.status, headers=headers, reason=answer.status.phrase)
    events = (response, h11.Data(data=body), h11.EndOfMessage())
    return b"".join(http.send(event) or b"" for event in events)
