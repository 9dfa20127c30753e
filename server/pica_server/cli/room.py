"""`pica room`: look at the rooms of a relay that runs with --admin-port, and manage them.

Every command raises `AdminRequestError` if the relay cannot be reached, or says no.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote, urlsplit

import httpx
import tyro

from pica_server.errors import AdminRequestError, ConfigurationError
from pica_server.ops.certificate import trusting
from pica_server.room.rulings import RULING_S

TIMEOUT_S: Final = 10.0
MAX_ANSWER_BYTES: Final = 16_777_216

Room = tyro.conf.Positional[str]


@dataclass(frozen=True, kw_only=True, slots=True)
class AdminOptions:
    """Which relay, and the right to manage it."""

    url: str = "http://127.0.0.1:8766"
    """Address of the relay's admin port."""
    token_file: Path | None = None
    """File with an admin's token, from `pica token --admin`; a relay without keys wants none."""
    ca_file: Path | None = None
    """File of certificates to trust besides those of the system, for https://."""

    def __post_init__(self) -> None:
        parts = urlsplit(self.url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ConfigurationError(f"--url {self.url} is no address: write http://HOST:PORT")


@dataclass(frozen=True, kw_only=True, slots=True)
class RoomOptions(AdminOptions):
    """Which room of the relay."""

    room: Room
    """Name of the room."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RemoveOptions(RoomOptions):
    """One peer of a room."""

    peer: tyro.conf.Positional[str]
    """Id of the peer, see `pica room inspect`."""
    bar: bool = False
    """Also keep its identity out."""
    for_s: float = RULING_S
    """Seconds for which it is kept out, also when the room has ended: 30 days at most."""


@dataclass(frozen=True, kw_only=True, slots=True)
class UnbarOptions(RoomOptions):
    """An identity that may come into a room again."""

    identity: tyro.conf.Positional[str]
    """Who, as their token names them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BarOptions(UnbarOptions):
    """An identity that is kept out of a room."""

    for_s: float = RULING_S
    """Seconds for which it is kept out, also when the room has ended: 30 days at most."""


@dataclass(frozen=True, kw_only=True, slots=True)
class MuteOptions(RoomOptions):
    """What a peer publishes."""

    peer: tyro.conf.Positional[str]
    """Id of the peer, see `pica room inspect`."""
    stream: int | None = None
    """One stream of it alone; all of them by default."""


def room_list(options: AdminOptions) -> dict[str, Any]:
    """List the rooms of a relay."""
    answer = _ask(options, "GET", "rooms")
    for room in answer["rooms"]:
        away = f", {room['num_away']} away" if room["num_away"] else ""
        muted = f", {room['num_muted']} muted" if room["num_muted"] else ""
        print(
            f"{room['room']}: {room['num_peers']} peers{away}, {room['num_streams']} streams{muted}"
        )
    return answer


def room_inspect(options: RoomOptions) -> dict[str, Any]:
    """Show who is in a room, and what they publish."""
    answer = _ask(options, "GET", "rooms", options.room)
    for peer in answer["peers"]:
        state = " (away)" if peer["away"] else ""
        identity = f" as {peer['identity']}" if peer["identity"] else ""
        print(f"{peer['peer_id']}: {peer['name']}{identity}{state}")
        for track in peer["tracks"]:
            muted = ", muted" if track["muted"] else ""
            print(f"  stream {track['stream']}: {track['kind']}{muted}")
    return answer


def room_close(options: RoomOptions) -> dict[str, Any]:
    """Put everybody out of a room."""
    answer = _ask(options, "DELETE", "rooms", options.room)
    print(f"closed {options.room}: {answer['removed']} peers removed")
    return answer


def room_remove(options: RemoveOptions) -> dict[str, Any]:
    """Put somebody out of a room."""
    query = f"?bar=true&for_s={options.for_s}" if options.bar else ""
    answer = _ask(options, "DELETE", "rooms", options.room, "peers", options.peer, query=query)
    kept_out = ", and keeps them out" if answer["barred"] else ""
    if options.bar and not kept_out:
        kept_out = "; they came without a token, so nothing keeps them from coming again"
    print(f"removed {options.peer} from {options.room}{kept_out}")
    return answer


def room_bar(options: BarOptions) -> dict[str, Any]:
    """Put an identity out of a room and keep it out; it need not be there, save in a cluster."""
    query = f"?for_s={options.for_s}"
    answer = _ask(options, "PUT", "rooms", options.room, "bars", options.identity, query=query)
    print(f"{options.identity} is kept out of {options.room} for {options.for_s:g} s")
    return answer


def room_unbar(options: UnbarOptions) -> dict[str, Any]:
    """Let an identity come into a room again."""
    answer = _ask(options, "DELETE", "rooms", options.room, "bars", options.identity)
    print(f"{options.identity} may come into {options.room} again")
    return answer


def room_mute(options: MuteOptions) -> dict[str, Any]:
    """Stop what somebody publishes; they and the others are told."""
    return _mute(options, "PUT")


def room_unmute(options: MuteOptions) -> dict[str, Any]:
    """Let what somebody publishes go on."""
    return _mute(options, "DELETE")


def _mute(options: MuteOptions, method: str) -> dict[str, Any]:
    is_one = options.stream is not None
    what = ("streams", str(options.stream)) if is_one else ("peers", options.peer)
    answer = _ask(options, method, "rooms", options.room, *what, "muted")
    print(f"{'muted' if answer['muted'] else 'unmuted'} streams {answer['streams']}")
    return answer


def _ask(options: AdminOptions, method: str, *path: str, query: str = "") -> dict[str, Any]:
    """Send one request and return the relay's answer; the parts of the path are quoted here."""
    headers = {}
    if options.token_file is not None:
        try:
            token = options.token_file.read_text(encoding="ascii").strip()
        except (OSError, UnicodeDecodeError) as error:
            what = error.strerror if isinstance(error, OSError) else "no token"
            raise ConfigurationError(f"--token-file {options.token_file}: {what}") from error
        headers["Authorization"] = f"Bearer {token}"
    target = "/v1/" + "/".join(quote(part, safe="") for part in path) + query
    url = options.url.rstrip("/") + target
    tls = trusting("--ca-file", options.ca_file)
    try:
        with (
            httpx.Client(verify=tls, trust_env=False, timeout=TIMEOUT_S) as client,
            client.stream(method, url, headers=headers) as response,
        ):
            body = b""
            for part in response.iter_bytes():
                body += part
                if len(body) > MAX_ANSWER_BYTES:
                    raise ValueError("its answer is too long")
        answer = json.loads(body)
    except (httpx.HTTPError, httpx.InvalidURL, ValueError) as error:
        what = str(error) or type(error).__name__
        raise AdminRequestError(
            f"no relay answers admins at {options.url} ({what}); start it with --admin-port"
        ) from error
    if not isinstance(answer, dict):
        raise AdminRequestError(f"{options.url}: that is no relay's answer")
    if response.status_code != 200:
        raise AdminRequestError(f"{options.url}: {answer.get('error', response.status_code)}")
    return answer
