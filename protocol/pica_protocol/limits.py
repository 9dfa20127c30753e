"""Every number that bounds a message, and the checks that quote them.

The checks raise ``ValueError`` with field, value and limit. A message checks itself when it is
made, so one written here is as well-formed as one that was read from a stranger.
"""

import codecs
import re
import unicodedata
from collections.abc import Sized
from typing import Any
from urllib.parse import urlsplit

MAX_FRAME_BYTES = 1200
"""Header and payload of one media frame: fits a datagram on any path (chosen: RFC 9000 14.1)."""
MAX_MEDIA_MESSAGE_BYTES = 16_384
"""One websocket message of media frames (chosen: 13 of the largest frames, a TLS record)."""
MAX_CONTROL_BYTES = 131_072
"""One control message from the relay: ``Joined`` with the largest room fits; a test proves it."""
MAX_CLIENT_MESSAGE_BYTES = 16_384
"""One message of either kind from a client: the relay reads no more than this at once."""
MAX_STREAM = 65_535
"""Streams are unsigned 16 bit, unique in a room; 0 means "not allotted yet"."""
MAX_PEERS = 64
"""Peers in one room that a message can name (chosen: a conference, not a stadium)."""
MAX_TRACKS = 4
"""Tracks of one peer: face, voice, and two to spare (chosen)."""
MAX_METADATA_ENTRIES = 8
"""Entries in what a peer says of itself."""
MAX_METADATA_KEY_BYTES = 16
MAX_METADATA_VALUE_BYTES = 64
"""Of one entry; all of them together take less than 700 bytes (chosen: a role, a seat, a raised
hand; what is larger belongs behind an address that stands here)."""
MAX_DEADLINE_MS = 10_000
"""How long a frame of an ordered track may wait for its receiver, at most."""
MAX_NAME_BYTES = 64
"""A peer's display name, in UTF-8."""
MAX_REASON_BYTES = 120
"""A close reason, in UTF-8; a websocket close frame carries 123 (RFC 6455 5.5)."""
MAX_WHISPER_BYTES = 512
"""Opaque bytes one peer may send to another through the relay: a wrapped key fits (chosen)."""
MAX_PASS_BYTES = 2048
"""A join token: its claims and signature, in base64 (chosen: fourteen avatar ids fit). No text in a
message is longer."""
MAX_URL_BYTES = 256
"""The address of another relay (chosen: a host name is at most 253 characters, a usual one 30)."""
MAX_MAP_FIELDS = 16
"""Fields in one map; room for later versions to add some."""
_TOKEN = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_PASS = re.compile(r"[A-Za-z0-9_.-]*")
_RELAY_URL = re.compile(r"wss?://([A-Za-z0-9.-]+|\[[0-9a-fA-F:.]+\])(:\d{1,5})?(/[!-~]*)?")
_SHA256_HEX = re.compile(r"[0-9a-f]{64}")
_BLANK_LETTERS = "\u115f\u1160\u2800\u3164\uffa0\U0001d159"
"""Printable, neither space nor mark, and drawn as nothing: Hangul fillers, the empty Braille cell,
the note without a head."""


def check_range(field: str, value: int, low: int, high: int) -> None:
    """Refuse an integer outside [low, high]."""
    if not low <= value <= high:
        raise ValueError(f"{field} must be in {low}..{high}, got {value}")


def check_token(field: str, value: str) -> None:
    """Refuse anything but 1 to 64 of ``A-Z a-z 0-9 _ . -``: names that end up in logs and paths."""
    if not _TOKEN.fullmatch(value):
        raise ValueError(f"{field} must be 1..64 of A-Z a-z 0-9 _ . -, got {quoted(value)}")


def check_text(field: str, value: str, max_bytes: int, *, required: bool = False) -> None:
    """Refuse text that is too long in UTF-8, or holds what could confuse a terminal."""
    if required and not value.strip():
        raise ValueError(f"{field} must not be empty")
    if not value.isprintable():
        raise ValueError(f"{field} must be printable text, got {quoted(value)}")
    if len(value.encode()) > max_bytes:
        raise ValueError(f"{field} must be at most {max_bytes} bytes of UTF-8, got {quoted(value)}")


def draws_nothing(character: str) -> bool:
    """Return True if a character leaves no ink of its own: a space, a mark, a control, a filler."""
    return character in _BLANK_LETTERS or unicodedata.category(character)[0] in "MZC"


def check_name(field: str, value: str) -> None:
    """Refuse what is no name that people can see: too long, not printable, or without any ink."""
    check_text(field, value, MAX_NAME_BYTES, required=True)
    if all(map(draws_nothing, value)):
        raise ValueError(f"{field} must be a name that can be seen, got {quoted(value)}")


def text_of_file(content: bytes) -> str:
    """Return the text of a file in UTF-8, or in UTF-16 where a byte order mark says so, as Windows
    PowerShell writes what a command prints.

    Raises:
        UnicodeDecodeError: It is no text.
    """
    is_utf_16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return content.decode("utf-16" if is_utf_16 else "utf-8-sig")


def check_pass(field: str, value: str) -> None:
    """Refuse what cannot be a join token, without quoting it: it may be a secret."""
    if len(value) > MAX_PASS_BYTES or not _PASS.fullmatch(value):
        raise ValueError(f"{field} must be at most {MAX_PASS_BYTES} of A-Z a-z 0-9 _ . -")


def check_metadata(field: str, entries: tuple[tuple[str, str], ...]) -> None:
    """Refuse too many entries, a key twice, or a key or value out of its limits."""
    check_count(field, entries, MAX_METADATA_ENTRIES)
    for key, value in entries:
        check_token(f"{field} key", key)
        check_text(f"{field} key", key, MAX_METADATA_KEY_BYTES)
        check_text(f"{field}.{key}", value, MAX_METADATA_VALUE_BYTES)
    if len({key for key, _ in entries}) < len(entries):
        raise ValueError(f"{field} has a key twice")


def check_sha256(field: str, value: str) -> None:
    """Refuse anything but "" or 64 lower-case hexadecimal digits."""
    if value and not _SHA256_HEX.fullmatch(value):
        raise ValueError(f"{field} must be empty or 64 hexadecimal digits, got {quoted(value)}")


def is_avatar_id(text: str) -> bool:
    """Return True if this names a file of a store: 64 lower-case hexadecimal digits."""
    return _SHA256_HEX.fullmatch(text) is not None


def check_url(field: str, value: str) -> None:
    """Refuse anything but "" or a ``ws://`` or ``wss://`` address without a user in it."""
    if not value:
        return
    try:
        is_address = bool(_RELAY_URL.fullmatch(value)) and urlsplit(value).port != 0
    except ValueError:  # a host in brackets that is none, a port above 65,535
        is_address = False
    if len(value) > MAX_URL_BYTES or not is_address:
        raise ValueError(
            f"{field} must be empty or ws[s]://HOST[:PORT] in {MAX_URL_BYTES} bytes, "
            f"got {quoted(value)}"
        )


def check_relay_address(field: str, url: str) -> None:
    """Refuse what is no address of a relay that a user could mean."""
    try:
        parts = urlsplit(url)
        is_address = parts.scheme in ("ws", "wss") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        is_address = False
    if not is_address:
        raise ValueError(f"{field} {url!r} is no relay address; write ws://HOST:PORT")


def check_count(field: str, items: Sized, limit: int, what: str = "items") -> None:
    """Refuse a sequence with more than ``limit`` items, or bytes."""
    if len(items) > limit:
        raise ValueError(f"{field} must have at most {limit} {what}, got {len(items)}")


def quoted(value: object) -> str:
    """Show a value in an error without letting it fill the log: 40 ASCII characters at most."""
    if isinstance(value, (list, dict)):
        return f"a {type(value).__name__} of {len(value)}"
    text = ascii(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def printable(text: str) -> str:
    """Return a text in which nothing steers the terminal that shows it; lines stay lines."""
    return "".join(char if char.isprintable() or char == "\n" else " " for char in text)


def clipped_reason(reason: str) -> str:
    """Make any text fit the limits of a close reason: printable, at most 120 bytes of UTF-8."""
    clean = printable(reason).replace("\n", " ")
    return clean.encode("utf-8", "replace")[:MAX_REASON_BYTES].decode("utf-8", "ignore")


def bound_tls_buffer(transport: Any) -> bool:
    """Let TLS, if there is any, write no further ahead than one message; return whether there is.

    The limits of a TLS transport of asyncio hold for what is not encrypted yet; the plain transport
    under it takes 64 KiB more, which is seconds of a slow reader's time. The standard library has
    no public way to it; a test notices when this one ends.
    """
    plain = getattr(getattr(transport, "_ssl_protocol", None), "_transport", None)
    if plain is not None:
        plain.set_write_buffer_limits(high=0)
    return plain is not None
