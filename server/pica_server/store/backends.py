"""Where the avatar store keeps its files: a folder, or whatever else fsspec has a driver for.

Everything here blocks, and is called in the store's threads. A file is there under its final name
whole or not at all. Names are made here of an id that was checked to be 64 hexadecimal digits, and
of nothing else.
"""

import functools
import os
import secrets
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

from fsspec.core import url_to_fs
from fsspec.implementations.local import LocalFileSystem

from pica_protocol.store import is_avatar_id
from pica_server.errors import StoreError
from pica_server.store.own_folder import OwnFolder, clear_orphans

SUFFIX: Final = ".pica"
TEMPORARY: Final = "temporary"
"""Names a folder that is made with the first file, and ends with the relay."""
INCOMING: Final = "incoming"
"""Folder of what is not complete yet, beside the files."""
ABANDONED_AFTER_S: Final = 86_400.0
"""What lies in there for a day was left by a relay that died."""

P = ParamSpec("P")
T = TypeVar("T")


def _in_os_terms(action: Callable[P, T]) -> Callable[P, T]:
    """Let what a driver raises be an OSError, as what a folder raises is."""

    @functools.wraps(action)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return action(*args, **kwargs)
        except OSError:
            raise
        except Exception as error:
            raise OSError(f"{type(error).__name__}: {error}") from error

    return run


class Backend:
    """Files by id in one folder of one file system; what comes in is spooled on this machine."""

    def __init__(self, where: str) -> None:
        """Find the driver of ``temporary``, a folder, or an fsspec URL.

        Raises:
            StoreError: There is no driver, or the URL is wrong.
        """
        self._name = _without_secrets(where)
        self._files: Any = LocalFileSystem()
        self._root = ""  # of a temporary store until its first file
        self._spool: Path | None = None
        self._made: OwnFolder | None = None
        self._spooling = threading.Lock()
        if "://" in where:
            try:
                # A cached listing would not know what another relay has put there.
                self._files, self._root = url_to_fs(where, use_listings_cache=False)
            except (ImportError, ValueError, TypeError) as error:
                raise StoreError(f"--avatar-store {self._name}: {error}") from error
            self._root = self._root.rstrip("/")
        elif where != TEMPORARY:
            self._root = str(Path(where).expanduser().absolute())
        self._is_local = isinstance(self._files, LocalFileSystem)
        if self._is_local and self._root:
            self._spool = Path(self._root, INCOMING)

    def prepare(self, limit: int) -> dict[str, int]:
        """Make sure that files can be kept here, and return the size of those that are, by id.

        Raises:
            StoreError: They cannot, or there are more than ``limit``.
        """
        if self._spool is None:
            clear_orphans()
        if not self._root:
            return {}
        incoming = f"{self._root}/{INCOMING}"
        try:
            self._files.makedirs(incoming, exist_ok=True)
            trial = f"{incoming}/{secrets.token_hex(16)}"
            self._files.pipe_file(trial, b"trial")
            self._files.rm_file(trial)
            if self._spool is not None:
                _delete_abandoned(self._spool)
            entries = self._files.ls(self._root, detail=True)
        except Exception as error:  # drivers raise what they like
            what = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
            raise StoreError(
                f"--avatar-store {self._name} cannot be written: {what}; "
                "give the relay a folder of its own, or none"
            ) from error
        found = {}
        for entry in entries:
            identity = _identity(str(entry["name"]).rpartition("/")[2])
            if identity is not None and entry.get("type") == "file":
                found[identity] = int(entry["size"] or 0)
        if len(found) > limit:
            raise StoreError(
                f"--avatar-store {self._name} holds more than {limit} avatars; "
                "raise --store.max-avatars, or remove some"
            )
        return found

    def spool(self) -> Path:
        """Return a path for a new local file that becomes one of ours, or is deleted."""
        with self._spooling:  # uploads come from several threads
            if self._spool is None:
                self._made = OwnFolder()
                self._spool = self._made.path
                self._root = self._root or str(self._spool)
        return self._spool / f"{secrets.token_hex(16)}.part"

    @_in_os_terms
    def keep(self, spooled: Path, identity: str) -> None:
        """Keep a spooled file under an id, and delete it there."""
        if self._is_local:
            with spooled.open("rb+") as file:
                os.fsync(file.fileno())  # else a crash could leave a whole name on half a file
            spooled.replace(self._path(identity))
        else:
            # Not every driver writes all or nothing, but renaming is.
            unfinished = f"{self._root}/{INCOMING}/{spooled.stem}"
            self._files.put_file(str(spooled), unfinished)
            self._files.mv(unfinished, self._path(identity))
            spooled.unlink()

    @_in_os_terms
    def size(self, identity: str) -> int | None:
        """Return a file's size, or None."""
        if self._root:
            with suppress(FileNotFoundError):
                return int(self._files.info(self._path(identity))["size"])
        return None

    @_in_os_terms
    def read(self, identity: str, begin: int, end: int) -> bytes:
        """Return a part of a file."""
        return bytes(self._files.cat_file(self._path(identity), start=begin, end=end))

    def close(self) -> None:
        """Delete what was temporary."""
        if self._made is not None:
            self._made.remove()

    def _path(self, identity: str) -> str:
        if not is_avatar_id(identity):
            raise ValueError("nothing but an id is ever joined to a path")
        return f"{self._root}/{identity}{SUFFIX}"


def _identity(name: str) -> str | None:
    identity = name.removesuffix(SUFFIX)
    return identity if name.endswith(SUFFIX) and is_avatar_id(identity) else None


def _delete_abandoned(incoming: Path) -> None:
    for path in incoming.glob("*.part"):
        with suppress(OSError):  # another relay may be at it too
            if time.time() - path.stat().st_mtime > ABANDONED_AFTER_S:
                path.unlink()


def _without_secrets(where: str) -> str:
    scheme, separator, rest = where.partition("://")
    return f"{scheme}://{rest.rpartition('@')[2].partition('?')[0]}" if separator else where
