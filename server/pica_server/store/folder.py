"""Where the avatar store keeps its files: a folder, or an ``s3://`` URL by way of fsspec.

Everything here blocks, and is called in the store's threads. A file is there under its final name
whole or not at all. Names are made of an id that was checked to be 64 hexadecimal digits, and of
nothing else.
"""

import os
import secrets
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from fsspec.core import url_to_fs
from fsspec.implementations.local import LocalFileSystem

from pica_protocol.store import is_avatar_id
from pica_server.errors import StoreError

SUFFIX: Final = ".pica"
TEMPORARY: Final = "temporary"
"""Names a folder that ends with the relay."""


class AvatarFolder:
    """Files by id in one folder."""

    def __init__(self, where: str) -> None:
        """Find ``temporary``, a folder, or an ``s3://`` URL.

        Raises:
            StoreError: It is another URL, or s3fs is missing.
        """
        self._name = _without_secrets(where)
        self._files: Any = LocalFileSystem()
        self._root = ""  # of a temporary store until it is prepared
        self._made: TemporaryDirectory[str] | None = None
        if where.startswith("s3://"):
            try:
                # A cached listing would not know what another relay has put there.
                self._files, root = url_to_fs(where, use_listings_cache=False)
            except ImportError as error:
                raise StoreError(
                    f"--avatar-store {self._name} needs s3fs: pip install 'pica-telepresence[s3]'"
                ) from error
            self._root = root.rstrip("/")
        elif "://" in where:
            raise StoreError(f"--avatar-store {self._name} is neither a folder nor an s3:// URL")
        elif where != TEMPORARY:
            self._root = str(Path(where).expanduser().absolute())

    @property
    def _is_local(self) -> bool:
        return isinstance(self._files, LocalFileSystem)

    def prepare(self, limit: int) -> dict[str, int]:
        """Make sure that files can be kept here, and return the size of those that are, by id.

        Raises:
            StoreError: They cannot, or there are more than ``limit``.
        """
        try:
            if not self._root:
                self._made = TemporaryDirectory(prefix="pica-avatars-")
                self._root = self._made.name
            elif self._is_local:
                Path(self._root).mkdir(parents=True, exist_ok=True)
            trial = f"{self._root}/{secrets.token_hex(16)}"
            self._files.pipe_file(trial, b"trial")
            # A bucket has no empty folders: the trial is still there when it is listed.
            entries = self._files.ls(self._root, detail=True)
            self._files.rm_file(trial)
        except Exception as error:  # drivers raise what they like
            what = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
            raise StoreError(
                f"--avatar-store {self._name} cannot be written: {what}; "
                "give the relay a folder of its own, or none"
            ) from error
        found = {}
        for entry in entries:
            name = str(entry["name"]).rpartition("/")[2]
            identity = name.removesuffix(SUFFIX)
            if name.endswith(SUFFIX) and is_avatar_id(identity) and entry.get("type") == "file":
                found[identity] = int(entry["size"] or 0)
        if len(found) > limit:
            raise StoreError(
                f"--avatar-store {self._name} holds more than {limit} avatars; "
                "raise --store.max-avatars, or remove some"
            )
        return found

    def keep(self, identity: str, data: bytes | bytearray) -> None:
        """Keep a file under an id."""
        if not self._is_local:
            self._files.pipe_file(self._path(identity), bytes(data))  # S3 shows whole files only
            return
        unfinished = Path(self._root, f"{secrets.token_hex(16)}.part")
        try:
            with unfinished.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())  # else a crash could leave a whole name on half a file
            unfinished.replace(self._path(identity))
        finally:
            unfinished.unlink(missing_ok=True)

    def size(self, identity: str) -> int | None:
        """Return a file's size, or None."""
        with suppress(FileNotFoundError):
            return int(self._files.info(self._path(identity))["size"])
        return None

    def read(self, identity: str, begin: int, end: int) -> bytes:
        """Return a part of a file."""
        return bytes(self._files.cat_file(self._path(identity), start=begin, end=end))

    def close(self) -> None:
        """Delete what was temporary."""
        if self._made is not None:
            self._made.cleanup()

    def _path(self, identity: str) -> str:
        if not is_avatar_id(identity):
            raise ValueError("nothing but an id is ever joined to a path")
        return f"{self._root}/{identity}{SUFFIX}"


def _without_secrets(where: str) -> str:
    scheme, separator, rest = where.partition("://")
    return f"{scheme}://{rest.rpartition('@')[2].partition('?')[0]}" if separator else where
