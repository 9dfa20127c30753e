"""Where a link leads, under which name, and with which token."""

import binascii
import json
import unicodedata
from base64 import urlsafe_b64decode
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from pica_client.errors import OptionError
from pica_protocol.limits import check_pass, check_text, check_token, text_of_file

_JOINERS: Final = dict.fromkeys((0x200C, 0x200D))
"""Keyboards of some scripts write them, and relays refuse what is invisible."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkConfig:
    """Where to connect, and under which name."""

    url: str = "ws://127.0.0.1:8765"
    """Address of the relay, ws:// or wss://."""
    redirect_hosts: tuple[str, ...] = ()
    """Other hosts that a relay may redirect us to, with our token. The host of the address needs
    none, nor do, over wss://, other names of its domain."""
    room: str = "lobby"
    """Room to join: 1 to 64 of A-Z a-z 0-9 _ . -"""
    name: str = "guest"
    """Name shown to the others, up to 64 bytes, in Unicode's form NFKC and without joiners."""
    connect_timeout_s: float | None = 3.0
    """How long to try the first time before giving up, seconds; None tries without end."""
    secret_file: Path | None = None
    """File with the room secret; with it, payloads are encrypted end to end. Needs the extra
    `seal`."""
    token_file: Path | None = None
    """File with the token that the relay wants, from `pica token`; read again for every join, so
    that a fresh one can be put there."""
    token: str = field(default="", repr=False)
    """The token itself, instead of a file; a secret."""

    def __post_init__(self) -> None:
        name = unicodedata.normalize("NFKC", self.name)  # wide spaces become ordinary ones
        object.__setattr__(self, "name", name.translate(_JOINERS))
        check_address(self.url)
        if self.token and self.token_file is not None:
            raise OptionError("token and token-file say the same thing; give one of them")
        try:
            check_token("room", self.room)
            check_text("name", self.name, 64, required=True)
            check_pass("token", self.token)
        except ValueError as error:
            raise OptionError(str(error)) from error


def check_address(url: str) -> None:
    """Refuse what is no address of a relay.

    Raises:
        OptionError: It is not of the form ws://HOST:PORT, or wss://.
    """
    try:
        parts = urlsplit(url)
        usable = parts.scheme in ("ws", "wss") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        usable = False
    if not usable:
        raise OptionError(f"url {url!r} is no relay address; write ws://HOST:PORT")


def read_token(path: Path | None) -> str:
    """Read a join token; empty without a file.

    Raises:
        OptionError: There is none in the file.
    """
    if path is None:
        return ""
    try:
        token = text_of_file(path.read_bytes()).strip()
        check_pass("token", token)
    except OSError as error:
        raise OptionError(f"token-file {path}: {error.strerror}") from error
    except ValueError as error:  # no text, or none that can be a token
        raise OptionError(f"token-file {path}: it holds no token") from error
    return token


def shown_name(name: str, token: str) -> str:
    """Return the name that others are shown: that of the join token, if it has one, or the given
    one. The signature does not matter here: it is our own token."""
    try:
        claims = json.loads(urlsafe_b64decode(token.split(".")[1] + "=="))
        said = claims.get("name", "")
    except (IndexError, binascii.Error, ValueError, AttributeError, RecursionError):
        said = ""
    return said if isinstance(said, str) and said else name
