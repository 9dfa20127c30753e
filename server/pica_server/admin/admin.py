"""What an admin may ask of a relay over HTTP, and what comes of it. Pure.

    GET    /v1/rooms                            every room, with its numbers
    GET    /v1/rooms/ROOM                       who is in it, and what they publish
    DELETE /v1/rooms/ROOM                       close it: everybody is put out
    DELETE /v1/rooms/ROOM/peers/PEER            put somebody out; ?bar=true keeps the identity out
    PUT    /v1/rooms/ROOM/bars/IDENTITY         put an identity out and keep it out; DELETE lets it
                                                come again
    PUT    /v1/rooms/ROOM/peers/PEER/muted      stop what somebody publishes; DELETE lets it go on
    PUT    /v1/rooms/ROOM/streams/STREAM/muted  the same for one stream

What keeps out takes ?for_s=SECONDS, a day by default.
In a cluster any node with peers in the room takes the order, and passes on what another must do.

Answers are JSON; an error is ``{"error": "..."}``. Whoever asks shows an admin's token, for one
room or for all, as ``Authorization: Bearer TOKEN``. A relay without keys answers its own machine
without one, but no web page: neither one that names its origin, nor one whose name was made to
point here.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, Final, NamedTuple
from urllib.parse import parse_qs, unquote, urlsplit

from pica_protocol.errors import CloseCode
from pica_protocol.limits import check_token, quoted
from pica_protocol.messages import Peer
from pica_server.auth.tokens import ANY_ROOM
from pica_server.errors import AdmissionError
from pica_server.net.proxies import names_this_machine
from pica_server.room.hub import Hub
from pica_server.room.room import Room
from pica_server.room.rulings import MAX_RULING_S, RULING_S

_SHOWN: Final = ("stream", "kind", "policy", "avatar")
"""The fields of a track that an admin sees."""


class Answer(NamedTuple):
    """What goes back to whoever asked: a status, a JSON body, more headers."""

    status: HTTPStatus
    body: dict[str, Any]
    headers: tuple[tuple[str, str], ...] = ()


class _RefusedError(Exception):
    def __init__(self, status: HTTPStatus, text: str, *headers: tuple[str, str]) -> None:
        super().__init__(text)
        self.answer = Answer(status, {"error": text}, headers)


@dataclass(eq=False)
class Admin:
    """The admin's side of one hub."""

    _hub: Hub
    _authority: Callable[[str], str] | None
    """Takes a token and returns the room that it is for, or raises `AdmissionError`; None: there
    are no tokens, who is on this machine may."""

    def answer(self, method: str, target: str, headers: Mapping[str, str], now: float) -> Answer:
        """Do what a request asks for; ``headers`` are by lower-case name."""
        try:
            scope = self._scope(headers)
            parts = urlsplit(target)
            path = tuple(unquote(part) for part in parts.path.split("/")[1:])
            query = parse_qs(parts.query)
            if path == ("v1", "rooms"):
                _allow(method, "GET")
                rooms = [
                    room
                    for room in self._hub.membership.rooms.values()
                    if scope in (ANY_ROOM, room.name)
                ]
                return _ok({"rooms": [_summary(room) for room in rooms]})
            if len(path) >= 3 and path[:2] == ("v1", "rooms"):
                if scope not in (ANY_ROOM, path[2]):
                    raise _RefusedError(HTTPStatus.FORBIDDEN, "the token is for another room")
                return self._of_room(method, path[2], path[3:], query, now)
            raise _RefusedError(HTTPStatus.NOT_FOUND, "there is nothing here; try /v1/rooms")
        except _RefusedError as error:
            return error.answer
        except ValueError:  # from the standard library's parsers
            return Answer(HTTPStatus.BAD_REQUEST, {"error": "what is asked for cannot be read"})

    def _scope(self, headers: Mapping[str, str]) -> str:
        if self._authority is None:
            if "origin" in headers or not names_this_machine(headers.get("host", "")):
                text = "this relay has no keys: it answers programs on its own machine only"
                raise _RefusedError(HTTPStatus.FORBIDDEN, text)
            return ANY_ROOM
        kind, _, token = headers.get("authorization", "").partition(" ")
        if kind.lower() != "bearer":
            raise _unauthorized("show an admin's token: Authorization: Bearer TOKEN")
        try:
            return self._authority(token.strip())
        except AdmissionError as error:
            if error.code == CloseCode.FORBIDDEN:
                raise _RefusedError(HTTPStatus.FORBIDDEN, str(error)) from error
            raise _unauthorized(str(error)) from error

    def _of_room(
        self,
        method: str,
        name: str,
        rest: tuple[str, ...],
        query: Mapping[str, list[str]],
        now: float,
    ) -> Answer:
        hub = self._hub
        room = hub.room(name)
        match rest:
            case ("bars", identity) if room is not None or hub.connections.cluster_peers is None:
                _allow(method, "PUT", "DELETE")
                self._check_bar(name, identity)
                is_barred, lasts_s = method == "PUT", _duration_s(query)
                hub.moderation.bar(name, identity, is_barred=is_barred, lasts_s=lasts_s, now=now)
                return _ok({"room": name, "identity": identity, "barred": is_barred})
        if room is None:
            raise _RefusedError(HTTPStatus.NOT_FOUND, "there is no such room on this relay")
        match rest:
            case ():
                _allow(method, "GET", "DELETE")
                if method == "GET":
                    peers = [self._peer_details(room, peer) for peer in room.peers]
                    return _ok({**_summary(room), "peers": peers})
                return _ok({"room": name, "removed": hub.moderation.close_room(name, now)})
            case ("peers", peer_id):
                _allow(method, "GET", "DELETE")
                peer = _peer(room, peer_id)
                if method == "GET":
                    return _ok(self._peer_details(room, peer))
                lasts_s = _duration_s(query)
                bar = query.get("bar", ["false"])[-1] == "true"
                barred = bar and hub.moderation.bar(name, peer.identity, lasts_s=lasts_s, now=now)
                hub.moderation.remove(name, peer_id, now=now)
                return _ok({"room": name, "peer_id": peer_id, "removed": True, "barred": barred})
            case ("peers", peer_id, "muted"):
                streams = [track.stream for track in _peer(room, peer_id).tracks]
                return self._mute(method, room, streams, now)
            case ("streams", number, "muted"):
                if not (number.isdecimal() and room.stream(int(number))):
                    raise _RefusedError(HTTPStatus.NOT_FOUND, "there is no such stream in the room")
                return self._mute(method, room, [int(number)], now)
        raise _RefusedError(HTTPStatus.NOT_FOUND, "a room has peers and streams, nothing else")

    def _check_bar(self, name: str, identity: str) -> None:
        """Refuse a bar that would hold nobody."""
        if self._authority is None:
            text = "this relay has no keys, so nobody has an identity"
            raise _RefusedError(HTTPStatus.CONFLICT, text)
        try:
            check_token("the room", name)
            check_token("the identity", identity)
        except ValueError as error:
            raise _RefusedError(HTTPStatus.BAD_REQUEST, str(error)) from error

    def _mute(self, method: str, room: Room, streams: list[int], now: float) -> Answer:
        _allow(method, "PUT", "DELETE")
        is_muted = method == "PUT"
        for number in streams:
            self._hub.moderation.mute(room.name, number, is_muted=is_muted, now=now)
        return _ok({"room": room.name, "streams": streams, "muted": is_muted})

    def _peer_details(self, room: Room, peer: Peer) -> dict[str, Any]:
        connection = self._hub.connections.by_peer.get(peer.peer_id)
        outbox = None if connection is None else connection.outbox
        muted = {number for number, stream in room.streams if stream.is_muted}
        return {
            "peer_id": peer.peer_id,
            "name": peer.name,
            "identity": peer.identity,
            "away": peer.peer_id in room.away,
            "node": room.node_of(peer.peer_id),
            "metadata": dict(peer.metadata),
            "tracks": [
                {**{name: getattr(track, name) for name in _SHOWN}, "muted": track.stream in muted}
                for track in peer.tracks
            ],
            "waiting_frames": None if outbox is None else outbox.waiting_frames,
            "waiting_control_bytes": None if outbox is None else outbox.waiting_control_bytes,
        }


def _summary(room: Room) -> dict[str, Any]:
    streams = [stream for _, stream in room.streams]
    return {
        "room": room.name,
        "num_peers": len(room.peers),
        "num_here": len(room),
        "num_away": len(room.away),
        "num_streams": len(streams),
        "num_muted": sum(stream.is_muted for stream in streams),
    }


def _peer(room: Room, peer_id: str) -> Peer:
    if peer_id not in room:
        raise _RefusedError(HTTPStatus.NOT_FOUND, "there is no such peer in the room")
    return room.peer(peer_id)


def _duration_s(query: Mapping[str, list[str]]) -> float:
    text = query.get("for_s", [f"{RULING_S}"])[-1]
    try:
        duration_s = float(text)
    except ValueError:
        duration_s = math.nan
    if not 1 <= duration_s <= MAX_RULING_S:
        text = f"for_s must be 1 to {MAX_RULING_S:.0f} seconds, got {quoted(text)}"
        raise _RefusedError(HTTPStatus.BAD_REQUEST, text)
    return duration_s


def _allow(method: str, *allowed: str) -> None:
    if method not in allowed:
        text = f"only {' and '.join(allowed)} can be done with this"
        raise _RefusedError(HTTPStatus.METHOD_NOT_ALLOWED, text, ("Allow", ", ".join(allowed)))


def _unauthorized(text: str) -> _RefusedError:
    return _RefusedError(HTTPStatus.UNAUTHORIZED, text, ("WWW-Authenticate", "Bearer"))


def _ok(body: dict[str, Any]) -> Answer:
    return Answer(HTTPStatus.OK, body)
