"""Invite links: an address to click on that says which relay and which room, and may let in. Pure.

    https://relay.example/standup                       wss://relay.example
    http://192.168.0.7:8765/standup                     ws://192.168.0.7:8765
    https://relay.example/calls/standup#token=eyJ…      wss://relay.example/calls

A browser finds the relay's page there, and the viewer takes the same link. The last part of the
path is the room. A token stands behind the #, which no server that a link passes through gets to
see; anyone with such a link can join.
"""

from dataclasses import dataclass, field
from urllib.parse import parse_qs, quote, unquote, urlencode, urlsplit

from pica_protocol.limits import check_pass, check_relay_address, check_token

SCHEMES = {"https": "wss", "http": "ws"}
"""Of a link, and of the relay that it leads to."""
MAX_LINK_LENGTH = 4096


@dataclass(frozen=True, kw_only=True, slots=True)
class Invite:
    """What a link says."""

    url: str
    """Address of the relay, ws:// or wss://."""
    room: str
    token: str = field(default="", repr=False)
    """Lets in; empty where none is needed. A secret."""

    def __post_init__(self) -> None:
        check_relay_address("url", self.url)
        check_token("room", self.room)
        check_pass("token", self.token)


def make_link(invite: Invite) -> str:
    """The link of an invitation."""
    parts = urlsplit(invite.url)
    host = parts.netloc.rpartition("@")[2]
    folder = parts.path.rstrip("/")
    scheme = "https" if parts.scheme == "wss" else "http"
    token = "#" + urlencode({"token": invite.token}) if invite.token else ""
    return f"{scheme}://{host}{folder}/{quote(invite.room)}{token}"


def parse_link(link: str) -> Invite:
    """What a link says.

    Raises:
        ValueError: It is no invite link: says what is wrong with it, and never its token.
    """
    text = link.strip()
    if len(text) > MAX_LINK_LENGTH:
        raise ValueError(f"an invite link of {len(text)} characters; {MAX_LINK_LENGTH} are allowed")
    try:
        parts = urlsplit(text)
        secrets = parse_qs(parts.fragment)
        is_usable = parts.scheme in SCHEMES and bool(parts.hostname) and parts.port != 0
    except ValueError:
        is_usable = False
    if not is_usable:
        raise ValueError("this is no invite link; one looks like https://HOST/ROOM")
    folder, _, room = parts.path.rpartition("/")
    if not room:
        raise ValueError("the invite link names no room; one looks like https://HOST/ROOM")
    host = parts.netloc.rpartition("@")[2]
    (token, *_) = secrets.get("token", [""])
    return Invite(url=f"{SCHEMES[parts.scheme]}://{host}{folder}", room=unquote(room), token=token)


def is_link(text: str) -> bool:
    """Whether a text is meant to be an invite link."""
    return text.strip().startswith(tuple(f"{scheme}://" for scheme in SCHEMES))
