"""The room secret: what the people of a call share beforehand, on a way that is not the relay's;
and how the encryption of a call stands, for people to see. Free of ciphers.

It lets the members of a room recognise each other's messages about keys. It does not encrypt
faces: those keys are made for each call and never derived from it, so a secret that gets known
later opens no recording of earlier calls.

The file holds one line, ``pica-secret-1:`` and 32 random bytes in URL-safe base64. A password in
its place is refused: an eavesdropper could try passwords offline.
"""

import hashlib
import os
import re
import stat
from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Final

from pica_client.errors import SealError
from pica_client.system import say
from pica_protocol.limits import text_of_file

SECRET_BYTES: Final = 32
RandomBytes = Callable[[int], bytes]
"""Returns so many unpredictable bytes; `os.urandom` outside tests."""

_LINE: Final = re.compile(r"pica-secret-1:([A-Za-z0-9_-]{43}=)\s*")


class RoomSecret:
    """Thirty-two bytes that do not print themselves."""

    def __init__(self, value: bytes) -> None:
        self.value = value

    @classmethod
    def new(cls) -> "RoomSecret":
        """Draw a new room secret from the system's randomness."""
        return cls(os.urandom(SECRET_BYTES))


def save_secret(path: Path, secret: RoomSecret) -> None:
    """Write a secret into a new file that its owner alone can read.

    Raises:
        SealError: There is a file already (a call may depend on it), or none can be made.
    """
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            with open(handle, "wb") as file:
                file.write(b"pica-secret-1:" + urlsafe_b64encode(secret.value) + b"\n")
        except OSError:  # half a secret would be in the way of the next try
            path.unlink()
            raise
    except FileExistsError as error:
        raise SealError(f"{path}: is there already; name a new file") from error
    except OSError as error:
        raise SealError(f"{path}: cannot be written: {error.strerror or error}") from error


def load_secret(path: Path) -> RoomSecret:
    """Read a secret.

    Raises:
        SealError: No such file, or one that `save_secret` did not write.
    """
    try:
        with path.open("rb") as file:
            found = _LINE.fullmatch(text_of_file(file.read(256)))
            is_open = os.name == "posix" and os.fstat(file.fileno()).st_mode & stat.S_IROTH
    except UnicodeDecodeError:
        found = None
    except OSError as error:
        raise SealError(f"{path}: cannot be read: {error.strerror or error}") from error
    if found is None:
        raise SealError(f"{path}: is no room secret; make one with `pica secret FILE`")
    if is_open:
        say(f"{path}: every user of this machine can read it; `chmod 600` keeps it secret")
    return RoomSecret(urlsafe_b64decode(found[1]))


CODE_GROUPS: Final = 6
CODE_ROUNDS: Final = 5000
"""Rounds of PBKDF2 behind the code (chosen: 3 ms; to have two groups of people see the same 30
digits takes 2^50 tries by the birthday bound, each as slow)."""


class SealState(Enum):
    """What is known of a peer's encryption. Only a verified peer is shown and counted."""

    note: str
    """What is wrong, in the few words that fit under a name; empty if nothing is known to be."""

    WAITING = "waiting", ""
    """Keys are on their way; nothing is known yet."""
    VERIFIED = "verified", ""
    """It knows the room secret, answered our challenge with its key, and describes itself as the
    relay does."""
    PLAIN = "plain", "not encrypted"
    """It has said nothing of keys for seconds: it does not encrypt, or is kept from saying so."""
    SECRET_DIFFERS = "secret differs", "secret differs: compare the secret files"
    """Its key messages are not made with our secret and room."""
    RELABELLED = "relabelled", "not who the relay says it is"
    """It describes itself otherwise than the relay does: name, avatar, tracks, streams."""

    def __new__(cls, value: str, note: str) -> "SealState":
        """Make a state of its name and its note."""
        state = object.__new__(cls)
        state._value_, state.note = value, note
        return state


@dataclass(frozen=True, kw_only=True)
class SealStatus:
    """How the encryption of the call stands, as of when we were last in the room."""

    room: str = ""
    """The room that we asked for."""
    peers: Mapping[str, SealState] = field(default_factory=dict)
    """Everybody else in the room, by peer id."""
    members: tuple[tuple[bytes, bytes], ...] = ()
    """Public key and description of us, and of each peer that was given our key."""

    @property
    def verified(self) -> frozenset[str]:
        """Ids of the peers that have proven to be here, and to know the secret."""
        return frozenset(who for who, state in self.peers.items() if state is SealState.VERIFIED)

    @cached_property
    def code(self) -> str:
        """Thirty digits in six groups, to be read aloud; empty while no other member can read us.

        It covers the room, and public key, name, avatar, tracks and streams of each who can read
        us, so it changes when a member comes, goes or reconnects. If two have different
        codes, the relay shows them different people. Takes milliseconds the first time.
        """
        if len(self.members) < 2:
            return ""
        text = b"".join(map(b"".join, sorted(self.members)))
        salt = b"pica seal code " + self.room.encode()
        digest = hashlib.pbkdf2_hmac("sha512", text, salt, CODE_ROUNDS, 5 * CODE_GROUPS)
        groups = (digest[i : i + 5] for i in range(0, len(digest), 5))
        return " ".join(f"{int.from_bytes(group) % 100_000:05d}" for group in groups)
