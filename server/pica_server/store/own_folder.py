"""A folder of a relay's own that ends with it, also when it is killed: then the next one clears it.

A relay holds a lock on a file in its folder for as long as it lives; the system gives it back when
the process ends, however it ends. Where there are no such locks, what a killed relay leaves stays.
"""

import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

PREFIX: Final = "pica-avatars-"
_LOCK: Final = "alive"


class OwnFolder:
    """A temporary folder that is locked while its relay lives."""

    def __init__(self) -> None:
        """Make it, readable for this user alone."""
        unnamed = Path(tempfile.mkdtemp(prefix="pica-new-"))
        self._lock = os.open(unnamed / _LOCK, os.O_CREAT | os.O_RDWR, 0o600)
        _is_taken(self._lock)
        # Only now under the name that others look for: it must never be there without its lock.
        self.path = unnamed.with_name(unnamed.name.replace("pica-new-", PREFIX))
        unnamed.rename(self.path)

    def remove(self) -> None:
        """Delete the folder with all that is in it."""
        shutil.rmtree(self.path, ignore_errors=True)
        os.close(self._lock)


def clear_orphans() -> None:
    """Delete the folders of this user's relays that have died."""
    if fcntl is None:
        return
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):  # somebody else's, or another relay is at it too
            if folder.lstat().st_uid != os.getuid() or folder.is_symlink():
                continue
            lock = os.open(folder / _LOCK, os.O_RDWR | os.O_NOFOLLOW)
            try:
                if not _is_taken(lock):
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(lock)


def _is_taken(lock: int) -> bool:
    """Take a lock, or say that a relay that lives has it."""
    with suppress(OSError):
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return False
    return True
