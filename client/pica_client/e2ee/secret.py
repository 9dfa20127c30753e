"""The room secret: what the people of a call share beforehand, on a way that is not the relay's.

It lets the members of a room recognise each other's messages about keys. It does not encrypt
faces: those keys are made for each call and never derived from it, so a secret that gets known
later opens no recording of earlier calls.

The file holds one line, ``pica-secret-1:`` and 32 random bytes in URL-safe base64. A password in
its place is refused: an eavesdropper could try passwords offline.
"""

import os
import re
from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Callable
from pathlib import Path
from typing import Final

from pica_client.errors import SecretFileError
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
        SecretFileError: There is a file already (a call may depend on it), or none can be made.
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
        raise SecretFileError(f"{path}: is there already; name a new file") from error
    except OSError as error:
        raise SecretFileError(f"{path}: cannot be written: {error.strerror or error}") from error


def load_secret(path: Path) -> RoomSecret:
    """Read a secret.

    Raises:
        SecretFileError: No such file, or one that `save_secret` did not write.
    """
    try:
        with path.open("rb") as file:
            found = _LINE.fullmatch(text_of_file(file.read(256)))
    except UnicodeDecodeError:
        found = None
    except OSError as error:
        raise SecretFileError(f"{path}: cannot be read: {error.strerror or error}") from error
    if found is None:
        raise SecretFileError(f"{path}: is no room secret; make one with `pica secret FILE`")
    return RoomSecret(urlsafe_b64decode(found[1]))
