"""Where the avatar store keeps its files: a folder, or whatever fsspec has a driver for.

Everything here blocks, and is called in the store's threads. A file is there under its final name
whole or not at all. Names are made here of an id that was checked to be 64 hexadecimal digits, and
of nothing else.
"""

import os
import secrets
import shutil
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Protocol

from pica_protocol.store import is_avatar_id
from pica_server.errors import StoreError

SUFFIX: Final = ".pica"
INCOMING: Final = "incoming"
"""Folder of what is not complete yet, beside the files."""
ABANDONED_AFTER_S: Final = 86_400.0
"""What lies in there for a day was left by a relay that died."""


class Place(Protocol):
    """Keeps files by id."""

    def prepare(self, limit: int) -> dict[str, int]:
        """Make sure that files can be kept here, and return the size of those that are, by id.

        Raises:
            StoreError: They cannot, or there are more than ``limit``.
        """
        ...

    def spool(self) -> Path:
        """Return a path for a new local file that becomes one of ours, or is deleted."""
        ...

    def keep(self, spooled: Path, identity: str) -> None:
        """Keep a spooled file under an id, and delete it there."""
        ...

    def size(self, identity: str) -> int | None:
        """Return a file's size, or None."""
        ...

    def read(self, identity: str, begin: int, end: int) -> bytes:
        """Return a part of a file."""
        ...

    def close(self) -> None:
        """Clear up."""
        ...


def open_place(where: str) -> Place:
    """Return the place that a setting names: ``temporary``, a folder, or an fsspec URL.

    Raises:
        StoreError: It has no driver, or a URL is wrong.
    """
    if where == "temporary":
        return TemporaryPlace()
    return UrlPlace(where) if "://" in where else FolderPlace(Path(where).expanduser())


class FolderPlace:
    """Files in a folder of this machine."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def prepare(self, limit: int) -> dict[str, int]:
        """See `Place.prepare`."""
        found: dict[str, int] = {}
        try:
            incoming = self._folder / INCOMING
            incoming.mkdir(parents=True, exist_ok=True)
            _delete_abandoned(incoming)
            trial = self.spool()
            trial.touch()
            trial.unlink()
            with os.scandir(self._folder) as entries:
                for entry in entries:
                    identity = _identity(entry.name)
                    if identity is None or not entry.is_file(follow_symlinks=False):
                        continue
                    found[identity] = entry.stat(follow_symlinks=False).st_size
                    _check_count(len(found), limit, str(self._folder))
        except OSError as error:
            raise StoreError(
                f"--avatar-store {self._folder} cannot be written: {error.strerror or error}; "
                "give the relay a folder of its own, or none"
            ) from error
        return found

    def spool(self) -> Path:
        """See `Place.spool`."""
        return self._folder / INCOMING / f"{secrets.token_hex(16)}.part"

    def keep(self, spooled: Path, identity: str) -> None:
        """See `Place.keep`."""
        with spooled.open("rb+") as file:
            os.fsync(file.fileno())  # else a crash could leave a whole name on half a file
        os.replace(spooled, self._path(identity))

    def size(self, identity: str) -> int | None:
        """See `Place.size`."""
        with suppress(FileNotFoundError):
            return self._path(identity).stat().st_size
        return None

    def read(self, identity: str, begin: int, end: int) -> bytes:
        """See `Place.read`."""
        with self._path(identity).open("rb") as file:
            file.seek(begin)
            return file.read(end - begin)

    def close(self) -> None:
        """See `Place.close`."""

    def _path(self, identity: str) -> Path:
        return self._folder / _file_name(identity)


class TemporaryPlace(FolderPlace):
    """A folder that is made with the first file, and ends with the relay."""

    def __init__(self) -> None:
        self._made: Path | None = None

    def prepare(self, limit: int) -> dict[str, int]:
        """See `Place.prepare`; there is nothing yet."""
        return {}

    def spool(self) -> Path:
        """See `Place.spool`."""
        if self._made is None:
            self._made = Path(tempfile.mkdtemp(prefix="pica-avatars-"))
            super().__init__(self._made)
            super().prepare(0)
        return super().spool()

    def size(self, identity: str) -> int | None:
        """See `Place.size`."""
        return None if self._made is None else super().size(identity)

    def close(self) -> None:
        """Delete everything."""
        if self._made is not None:
            shutil.rmtree(self._made, ignore_errors=True)


class UrlPlace:
    """Files behind an fsspec URL; what comes in is spooled in a folder of this machine first."""

    def __init__(self, url: str) -> None:
        """Find the driver.

        Raises:
            StoreError: There is none, or the URL is wrong.
            ModuleNotFoundError: Of fsspec itself: the extra ``store`` is missing.
        """
        # Only here: a relay with a folder does without.
        import fsspec

        self._url = url
        try:
            # A cached listing would not know what another relay has put there.
            self._files, root = fsspec.core.url_to_fs(url, use_listings_cache=False)
        except (ImportError, ValueError, TypeError) as error:
            raise StoreError(f"--avatar-store {_without_secrets(url)}: {error}") from error
        self._root = str(root).rstrip("/")
        self._spool: Path | None = None

    def prepare(self, limit: int) -> dict[str, int]:
        """See `Place.prepare`."""
        found: dict[str, int] = {}

        def look() -> None:
            self._files.makedirs(f"{self._root}/{INCOMING}", exist_ok=True)
            trial = f"{self._root}/{INCOMING}/{secrets.token_hex(16)}"
            self._files.pipe_file(trial, b"trial")
            self._files.rm_file(trial)
            for entry in self._files.ls(self._root, detail=True):
                identity = _identity(str(entry["name"]).rpartition("/")[2])
                if identity is not None and entry.get("type") == "file":
                    found[identity] = int(entry["size"] or 0)
                    _check_count(len(found), limit, _without_secrets(self._url))

        try:
            look()
        except StoreError:
            raise
        except Exception as error:  # drivers raise what they like
            raise StoreError(
                f"--avatar-store {_without_secrets(self._url)} cannot be written: "
                f"{type(error).__name__}: {error}"
            ) from error
        return found

    def spool(self) -> Path:
        """See `Place.spool`."""
        if self._spool is None:
            self._spool = Path(tempfile.mkdtemp(prefix="pica-avatars-"))
        return self._spool / f"{secrets.token_hex(16)}.part"

    def keep(self, spooled: Path, identity: str) -> None:
        """See `Place.keep`."""

        def put() -> None:
            # Not every driver writes all or nothing, but renaming is.
            unfinished = f"{self._root}/{INCOMING}/{spooled.stem}"
            self._files.put_file(str(spooled), unfinished)
            self._files.mv(unfinished, self._path(identity))

        _in_os_terms(put)
        spooled.unlink()

    def size(self, identity: str) -> int | None:
        """See `Place.size`."""
        with suppress(FileNotFoundError):
            return int(_in_os_terms(lambda: self._files.info(self._path(identity)))["size"])
        return None

    def read(self, identity: str, begin: int, end: int) -> bytes:
        """See `Place.read`."""
        path = self._path(identity)
        return bytes(_in_os_terms(lambda: self._files.cat_file(path, start=begin, end=end)))

    def close(self) -> None:
        """Delete what was spooled."""
        if self._spool is not None:
            shutil.rmtree(self._spool, ignore_errors=True)

    def _path(self, identity: str) -> str:
        return f"{self._root}/{_file_name(identity)}"


def _file_name(identity: str) -> str:
    if not is_avatar_id(identity):
        raise ValueError("nothing but an id is ever joined to a path")
    return f"{identity}{SUFFIX}"


def _identity(name: str) -> str | None:
    identity = name.removesuffix(SUFFIX)
    return identity if name.endswith(SUFFIX) and is_avatar_id(identity) else None


def _check_count(count: int, limit: int, place: str) -> None:
    if count > limit:
        raise StoreError(
            f"--avatar-store {place} holds more than {limit} avatars; raise --store.max-avatars, "
            "or remove some"
        )


def _delete_abandoned(incoming: Path) -> None:
    for path in incoming.glob("*.part"):
        with suppress(OSError):  # another relay may be at it too
            if time.time() - path.stat().st_mtime > ABANDONED_AFTER_S:
                path.unlink()


def _in_os_terms(action: Callable[[], Any]) -> Any:
    """Let what a driver raises be an OSError, as what a folder raises is."""
    try:
        return action()
    except OSError:
        raise
    except Exception as error:
        raise OSError(f"{type(error).__name__}: {error}") from error


def _without_secrets(url: str) -> str:
    scheme, _, rest = url.partition("://")
    return f"{scheme}://{rest.rpartition('@')[2].partition('?')[0]}"
