"""The page that a relay shows to browsers: a participant that needs no installation. Pure but for
`page_files`.

A link to a room is ``https://RELAY/ROOM#token=…``: the
page is the same for every room, and reads what stands in the link. It names its files by a folder
that changes with them, so a browser keeps them for good and never mixes two versions.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from http import HTTPStatus
from importlib import resources
from typing import Final

from pica_server.status_pages import Page
from pica_server.web import avatar_names, mouth_weights, shader_texts

CONTENT_TYPES: Final = {
    "css": "text/css; charset=utf-8",
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "json": "application/json",
    "svg": "image/svg+xml",
}
FOLDER: Final = "web/"
"""Before the names of files in the page; a version is put into it."""
_ROOM: Final = re.compile(r"[A-Za-z0-9_.-]{0,64}")
_HOST: Final = re.compile(r"[A-Za-z0-9.:\[\]-]{1,255}")
_HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), microphone=(self)",
}


def page_files() -> dict[str, str]:
    """The files of the page that are in this package, and the shaders of the client's, by name."""
    files = {
        each.name: each.read_text("utf-8")
        for each in resources.files("pica_server.web").iterdir()
        if each.name.rpartition(".")[2] in CONTENT_TYPES
    }
    made = {"avatars": avatar_names(), "mouth": mouth_weights(), "shaders": shader_texts()}
    return {**files, **{f"{name}.json": json.dumps(value) for name, value in made.items()}}


class WebPage:
    """The page and its files.

    Args:
        files: Texts by name; without an ``index.html`` there is no page.
    """

    def __init__(self, files: Mapping[str, str]) -> None:
        self._files = dict(files)
        digest = hashlib.sha256(repr(sorted(self._files.items())).encode()).hexdigest()
        self._folder = f"web-{digest[:16]}/"
        self._index = self._files.pop("index.html", "").replace(f'"{FOLDER}', f'"{self._folder}')

    def answer(self, path: str, host: str) -> Page | None:
        """Return the page for ``/`` and each name of a room, its files, and None for all else.

        Args:
            path: As it is asked for; a query changes nothing.
            host: The header of that name: what the page may connect to.
        """
        path = path.partition("?")[0].removeprefix("/")
        if self._index and _ROOM.fullmatch(path):
            headers = {"Cache-Control": "no-cache", "Content-Security-Policy": _policy(host)}
            return _page(self._index, "index.html", headers)
        name = path.removeprefix(self._folder)
        if name != path and name in self._files:
            headers = {"Cache-Control": "public, max-age=31536000, immutable"}
            return _page(self._files[name], name, headers)
        return None


def _policy(host: str) -> str:
    """What the page may load and connect to: this relay alone."""
    # 'self' covers websockets in some browsers only.
    sockets = f" ws://{host} wss://{host}" if _HOST.fullmatch(host) else ""
    return (
        f"default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'{sockets}; "
        "img-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    )


def _page(text: str, name: str, headers: Mapping[str, str]) -> Page:
    content_type = CONTENT_TYPES[name.rpartition(".")[2]]
    return Page(HTTPStatus.OK, text, content_type, {**_HEADERS, **headers})
