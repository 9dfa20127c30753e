"""Pages in a headless Chromium, served to it from here, that post what they find."""

import json
import threading
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Queue
from typing import Any

from helpers.chromium import chromium
from helpers.paths import ROOT
from pica_server.pages import shader_texts

WEB = ROOT / "server" / "pica_server" / "web"
PAGES = ROOT / "tests" / "web" / "pages"
TYPES = {".js": "text/javascript", ".html": "text/html", ".css": "text/css", ".json": "text/json"}


class _Handler(BaseHTTPRequestHandler):
    server: "_Server"

    def do_GET(self) -> None:
        name = self.path.split("?")[0].lstrip("/").removeprefix("web/")
        if name not in self.server.files and "." not in name:
            name = "index.html"
        content = self.server.files.get(name)
        if content is None:
            path = next((each / name for each in (PAGES, WEB) if (each / name).is_file()), None)
            content = None if path is None else path.read_bytes()
        self.send_response(404 if content is None else 200)
        self.send_header("Content-Type", TYPES.get(Path(name).suffix, "application/octet-stream"))
        self.end_headers()
        self.wfile.write(content or b"")

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.posted.put((self.path, body))
        self.send_response(200)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        pass


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, files: Mapping[str, bytes]) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.files = files
        self.posted: Queue[tuple[str, bytes]] = Queue()


def run_page(
    page: str, files: Mapping[str, bytes], *, timeout_s: float = 150.0, flags: tuple[str, ...] = ()
) -> tuple[dict[str, bytes], Any]:
    """Open a page of `PAGES` until it posts ``/done`` with JSON.

    Args:
        files: What is served beside the page's own folder and the modules, by name.

    Returns:
        What else it posted, by path, and what it found.
    """
    server = _Server({"shaders.json": json.dumps(shader_texts()).encode(), **files})
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    posted: dict[str, bytes] = {}
    try:
        with chromium(*flags) as tab:
            tab.open(f"http://127.0.0.1:{server.server_port}/{page}")
            while True:
                path, body = server.posted.get(timeout=timeout_s)
                if path == "/done":
                    found = json.loads(body)
                    assert "error" not in found, found["error"]
                    return posted, found
                posted[path] = body
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
