"""Giving a relay a file for its avatar store: the sub-protocol ``pica.store.1``.

A websocket of its own on the relay's port, one file each. The client sends ``Offer``; the relay
answers ``Stored`` when it has the file, else ``Ready``, and then takes chunks, in order, until it
has as many bytes as were offered. It checks them and answers ``Stored``. Whatever goes wrong on
either side ends with ``Bye`` and a close frame, as in ``pica.1``.

Getting a file back is plain HTTP: ``GET /avatars/ID``, see ``docs/wire.md``.
"""

import re
from dataclasses import dataclass, field
from typing import Annotated, Final, cast, get_args

from pica_protocol.errors import RemoteProtocolError
from pica_protocol.limits import MAX_CLIENT_MESSAGE_BYTES, quoted
from pica_protocol.messages import Bye, Checked, Pass, Sha256, wire_name, within

STORE_SUBPROTOCOL: Final = "pica.store.1"
"""The websocket sub-protocol of uploads; the digit changes when old peers could not follow."""

AVATARS_PATH: Final = "/avatars/"
"""Where files are got by HTTP; an id follows."""

CHUNK_KIND: Final = 3
"""First byte of a websocket message that carries a piece of a file."""

MAX_CHUNK_BYTES: Final = MAX_CLIENT_MESSAGE_BYTES - 1
"""Bytes of file in one message."""

MAX_OFFER_BYTES: Final = 2**40
"""What an offer can say; the relay's own limit is far below."""

_ID: Final = re.compile(r"[0-9a-f]{64}")
_CHUNK_PREFIX: Final = bytes([CHUNK_KIND])


@dataclass(frozen=True, kw_only=True, slots=True)
class Offer(Checked):
    """First message of an upload: which file comes."""

    sha256: Sha256
    """SHA-256 of the file's bytes, in hexadecimal: its id."""
    size: Annotated[int, within(1, MAX_OFFER_BYTES)]
    """Its length in bytes."""
    token: Pass = field(default="", repr=False)
    """A join token that allows to publish with this avatar; a relay with keys wants one."""

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        if not self.sha256:
            raise ValueError("offer.sha256 must not be empty")


@dataclass(frozen=True, kw_only=True, slots=True)
class Ready(Checked):
    """The relay does not have it: send it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Stored(Checked):
    """The relay has it, and anyone who knows its id can get it."""

    is_new: bool = False
    """Whether it has come with this upload; false: it was there already."""


StoreMessage = Offer | Ready | Stored | Bye

STORE_MESSAGE_TYPES: Final = cast(
    "dict[str, type[StoreMessage]]", {wire_name(cls): cls for cls in get_args(StoreMessage)}
)
"""The messages of this sub-protocol, as ``messages.MESSAGE_TYPES``."""


def is_avatar_id(text: str) -> bool:
    """Return True if this names a file of a store: 64 lower-case hexadecimal digits."""
    return _ID.fullmatch(text) is not None


def encode_chunk(data: bytes | memoryview) -> bytes:
    """Return the websocket message that carries a piece of a file."""
    if not 0 < len(data) <= MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk has 1..{MAX_CHUNK_BYTES} bytes, got {len(data)}")
    return _CHUNK_PREFIX + data


def decode_chunk(message: bytes) -> memoryview:
    """Return the piece of a file in a websocket message.

    Raises:
        RemoteProtocolError: It is no chunk, empty or too long.
    """
    if not message.startswith(_CHUNK_PREFIX):
        raise RemoteProtocolError(f"not a chunk of a file: first byte {quoted(message[:1])}")
    if not 1 < len(message) <= MAX_CHUNK_BYTES + 1:
        raise RemoteProtocolError(
            f"a chunk of {len(message) - 1} bytes, allowed are 1..{MAX_CHUNK_BYTES}"
        )
    return memoryview(message)[1:]
