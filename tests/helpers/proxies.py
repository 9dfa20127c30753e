"""What stands before a relay: a proxy that serves it in a folder; a relay that sends all away."""

import contextlib
import http
import socket
import threading
from collections.abc import Iterator

from websockets.datastructures import Headers
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve
from websockets.typing import Subprotocol

from pica_protocol import SUBPROTOCOL
from pica_protocol.codec import encode_message
from pica_protocol.messages import Bye
from pica_server.pages import WebPage, page_files


@contextlib.contextmanager
def folder_proxy(folder: str, relay_port: int) -> Iterator[int]:
    """A port at which a folder is what a relay of this machine serves, websockets and all."""

    def copy(source: socket.socket, target: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65_536):
                target.sendall(data)
            target.shutdown(socket.SHUT_WR)

    def serve_one(client: socket.socket) -> None:
        # A relay answers one request on a connection; one that has ended answers none.
        address, over = ("127.0.0.1", relay_port), contextlib.suppress(OSError)
        with client, over, socket.create_connection(address) as relay:
            relay.sendall(client.recv(65_536).replace(f" {folder}/".encode(), b" /", 1))
            back = threading.Thread(target=copy, args=(relay, client), daemon=True)
            back.start()
            copy(client, relay)
            back.join()

    def accept() -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = listener.accept()
                threading.Thread(target=serve_one, args=(client,), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=accept, daemon=True).start()
        yield listener.getsockname()[1]


@contextlib.contextmanager
def moving_relay(url: str) -> Iterator[str]:
    """The address of a relay that has the page, and sends participants who join to another one."""
    page = WebPage(page_files())

    def answer(connection: ServerConnection, request: Request) -> Response | None:
        found = page.answer(request.path, request.headers["Host"])
        if "Upgrade" in request.headers or found is None:
            return None if found else Response(404, "", Headers(), b"")
        headers = Headers({"Content-Type": found.content_type, **found.headers})
        body = found.text.encode()
        headers["Content-Length"] = str(len(body))
        return Response(found.status, http.HTTPStatus(found.status).phrase, headers, body)

    def send_away(connection: ServerConnection) -> None:
        connection.recv()
        connection.send(encode_message(Bye(code=1001, reason="moved", url=url)))
        connection.close(1001)

    with serve(
        send_away, "127.0.0.1", 0, process_request=answer, subprotocols=[Subprotocol(SUBPROTOCOL)]
    ) as s:
        threading.Thread(target=s.serve_forever, daemon=True).start()
        yield f"ws://127.0.0.1:{s.socket.getsockname()[1]}"
        s.shutdown()
