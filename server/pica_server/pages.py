"""What the relay answers to plain HTTP: is it alive, is there a place, its numbers, to admins who
is in its rooms, and to browsers a page: a participant that needs no installation.

Pure but for `page_files`, which finds files of other packages and imports none: a relay has none of
the libraries that those need. A link to a room is ``https://RELAY/ROOM#token=…``: the page is the
same for every room, and reads what stands in the link. It names its files by a folder that changes
with them, so a browser keeps them for good and never mixes two versions.
"""

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from http import HTTPStatus
from importlib import resources
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any, Final

from platformdirs import PlatformDirs

from pica_protocol.errors import CloseCode
from pica_server.config import RelayConfig
from pica_server.limits import RefusalError
from pica_server.room.connections import CALM_S
from pica_server.room.hub import Hub
from pica_server.room.room import Connection, Room
from pica_server.stats import CONTENT_TYPE, metrics_text
from pica_server.store.store import AvatarStore
from pica_server.tokens import ANY_ROOM

MAX_LISTED: Final = 1000
"""People in one answer to ``GET /rooms`` (chosen: 300 kB, some milliseconds of work)."""
CONTENT_TYPES: Final = {
    "css": "text/css; charset=utf-8",
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "json": "application/json",
    "svg": "image/svg+xml",
}
FOLDER: Final = "web/"
"""Before the names of files in the page; a version is put into it."""
_LATER: Final = "camera face finder live_face networks pulse upload worklet xr"
"""Modules that a page asks for when they are wanted."""
_ROOM: Final = re.compile(r"[A-Za-z0-9_.-]{0,64}")
_WORKERS: Final = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'"
"""What a worker may do: the one that sees a camera's pictures can send nothing."""
_HOST: Final = re.compile(r"[A-Za-z0-9.:\[\]-]{1,255}")
_HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), microphone=(self)",
}


@dataclass(frozen=True, slots=True)
class Page:
    """What is answered to a plain HTTP request."""

    status: HTTPStatus
    text: str
    content_type: str = "text/plain; charset=utf-8"
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(eq=False)
class StatusPages:
    """The pages of one relay."""

    _hub: Hub
    _config: RelayConfig
    _store: AvatarStore | None = None
    _admin_room: Callable[[str], str] | None = None
    """Takes a token and returns the room that it may moderate, or ``ANY_ROOM``; raises
    `RefusalError`. None: there are no tokens."""

    def answer(
        self, path: str, *, authorization: str = "", is_local: bool, now: float
    ) -> Page | None:
        """Return the page of a path, or None if there is none.

        Args:
            path: As it is asked for; a slash or a query at its end changes nothing.
            authorization: The header of that name; ``/rooms`` needs an admin's token in it.
            is_local: Whether this machine asks; some pages are for it only.
        """
        note = "NATS lost, new rooms are local" if self._has_lost_nats else ""
        match path.partition("?")[0].rstrip("/"):
            case "/healthz":
                # Lost NATS is no reason to start it again: its rooms go on.
                return _verdict("", note)
            case "/readyz":
                if self._hub.connections.is_draining:
                    return _verdict("draining")
                if self._hub.overload.refuses(now):
                    page = _verdict("late, no new peers are admitted")
                    return replace(page, headers={"Retry-After": f"{CALM_S:.0f}"})
                return _verdict("full" if self._hub.connections.is_full else "", note)
            case "/metrics" if is_local:
                return Page(HTTPStatus.OK, self._metrics(now), CONTENT_TYPE)
            case "/rooms":
                return self._rooms(authorization)
            case "/metrics":
                return Page(HTTPStatus.FORBIDDEN, "ask on this machine\n")
        return None

    def _rooms(self, authorization: str) -> Page:
        """List the rooms that an admin's token is for, and who is in them."""
        if self._admin_room is None:
            text = "this relay has no keys, so there are no admin tokens\n"
            return Page(HTTPStatus.FORBIDDEN, text)
        scheme, _, token = authorization.partition(" ")
        if scheme.lower() != "bearer":
            return _unauthorized("send an admin's token: Authorization: Bearer TOKEN")
        try:
            scope = self._admin_room(token.strip())
        except RefusalError as error:
            if error.code == CloseCode.UNAUTHORIZED:
                return _unauthorized(str(error))
            return Page(HTTPStatus.FORBIDDEN, f"{error}\n")
        rooms: list[dict[str, Any]] = []
        num_left, is_cut = MAX_LISTED, False
        for room in self._hub.membership.rooms.values():
            if scope in (ANY_ROOM, room.name):
                people = [_person(room, each) for each in islice(room.members.values(), num_left)]
                num_left -= len(people)
                is_cut = is_cut or len(people) < len(room.members)
                if people:
                    rooms.append({"room": room.name, "people": people})
        text = json.dumps({"rooms": rooms, "is_cut": is_cut})
        headers = {"Cache-Control": "no-store"}
        return Page(HTTPStatus.OK, f"{text}\n", "application/json", headers)

    @property
    def _has_lost_nats(self) -> bool:
        placement = self._hub.membership.placement
        return placement is not None and not placement.is_up

    def _metrics(self, now: float) -> str:
        hub = self._hub
        store = self._store
        used_bytes, num_free_bytes = (store.used_bytes, store.num_free_bytes) if store else (0, 0)
        gauges = {
            "avatars": store.num_avatars if store else 0,
            "avatar_store_bytes": used_bytes,
            "avatar_store_free_bytes": num_free_bytes,
            "nats_lost": self._has_lost_nats,
            "open_connections": hub.num_connections,
            "rooms": hub.num_rooms,
            "draining": hub.connections.is_draining,
            "overload": hub.overload.refuses(now),
        }
        return metrics_text(hub.stats, gauges)


def _verdict(trouble: str, note: str = "") -> Page:
    if trouble:
        return Page(HTTPStatus.SERVICE_UNAVAILABLE, f"{trouble}\n")
    return Page(HTTPStatus.OK, f"ok\n{note}\n" if note else "ok\n")


def _unauthorized(text: str) -> Page:
    headers = {"WWW-Authenticate": "Bearer"}
    return Page(HTTPStatus.UNAUTHORIZED, f"{text}\n", headers=headers)


def _person(room: Room, member: Connection) -> dict[str, Any]:
    peer, muted = member.peer, room.muted_of([member])
    return {
        "peer_id": peer.peer_id,
        "name": peer.name,
        "identity": peer.identity,
        "is_away": member.closed is not None,
        "tracks": [
            {"kind": track.kind, "stream": track.stream, "is_muted": track.stream in muted}
            for track in peer.tracks
        ],
    }


def page_files() -> dict[str, str]:
    """The files of the page that are in this package, and those that it needs of the client's."""
    files = {
        each.name: each.read_text("utf-8")
        for each in resources.files("pica_server.web").iterdir()
        if each.name.rpartition(".")[2] in CONTENT_TYPES
    }
    numbers = [*_files("pica_client", "voice/*.json"), *_files("pica_core", "face_networks.json")]
    files |= {each.name: each.read_text("utf-8") for each in numbers}
    made = {"avatars": avatar_names(), "shaders": shader_texts()}
    return files | {f"{name}.json": json.dumps(value) for name, value in made.items()}


class WebPage:
    """The page and its files.

    Args:
        files: Texts by name; without an ``index.html`` there is no page.
    """

    def __init__(self, files: Mapping[str, str]) -> None:
        self._files = dict(files)
        digest = hashlib.sha256(repr(sorted(self._files.items())).encode()).hexdigest()
        self._folder = f"web-{digest[:16]}/"
        # All modules that the first picture needs are asked for at once, not one behind the other.
        links = "".join(
            f'<link rel="modulepreload" href="{FOLDER}{name}" />\n'
            for name in sorted(self._files)
            if name.endswith(".js") and name[:-3] not in _LATER.split()
        )
        index = self._files.pop("index.html", "").replace("</head>", f"{links}</head>")
        self._index = index.replace(f'"{FOLDER}', f'"{self._folder}')

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
            headers = {
                "Cache-Control": "public, max-age=31536000, immutable",
                "Content-Security-Policy": _WORKERS,
            }
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


def shader_texts() -> dict[str, str]:
    """The shaders that the page composes, by name."""
    return {
        file.name: file.read_text(encoding="utf-8")
        for file in _files("pica_client", "render/shaders/*.*")
    }


def avatar_files() -> list[Path]:
    """The avatars that ship."""
    return _files("pica_core", "avatars/*.pica")


def face_networks() -> list[Path]:
    """What ``pica webcam setup`` has put on this machine, if it has; pages ask by its hash."""
    folder = PlatformDirs("pica-telepresence", appauthor=False, roaming=True).user_data_path
    return [*folder.glob("models/face_landmarker.task")]


def avatar_names() -> dict[str, str]:
    """The ids of the avatars that ship, by name."""
    return {
        path.stem.capitalize(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in avatar_files()
    }


def _files(package: str, pattern: str) -> list[Path]:
    found = find_spec(package)
    folders = [] if found is None else found.submodule_search_locations or []
    return sorted(file for folder in folders for file in Path(folder).glob(pattern))
