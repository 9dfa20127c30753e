"""The avatars a client knows: those that ship with the package, and files the user names.

An avatar travels as the SHA-256 of its file; a client that has the file has the avatar. Files are
hashed when a library is made and loaded when they are first asked for, in a thread: loading takes a
tenth of a second, in which neither network nor display may stand still.
"""

import threading
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Final, Protocol

from pica_client.errors import OptionError
from pica_core.avatar.file import SUFFIX, Avatar, avatar_id, load_avatar, shipped_avatar_files
from pica_core.errors import AvatarFileError
from pica_core.reference import still_map

MAX_LOADED_BYTES: Final = 256 * 2**20
"""Files whose avatars stay loaded (chosen: sixty of those that ship, which take three times as much
in memory)."""


class AvatarStore(Protocol):
    """Where a call finds avatars by hash; any thread may ask."""

    def get(self, identity: str) -> Avatar | None:
        """The avatar, or None while it is on its way; AvatarFileError if it is unknown here, must
        not be used, or will not come."""
        ...

    def note(self, identity: str) -> str:
        """How far an avatar is on its way, for people; empty when there is nothing to say."""
        ...


class AvatarLibrary:
    """Avatars in files: the shipped ones, and those that are found or added."""

    def __init__(self, *, shipped: Iterable[Path] | None = None) -> None:
        """Hash all files.

        Args:
            shipped: Instead of the package's own; for tests.

        Raises:
            AvatarFileError: A file cannot be read.
        """
        self._paths: dict[str, Path] = {}
        for path in shipped_avatar_files() if shipped is None else shipped:
            self._paths.setdefault(avatar_id(path), path)
        self._loading: dict[str, Future[Avatar]] = {}
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="avatars")

    @property
    def names(self) -> list[str]:
        """Names that `find` knows: file names without suffix."""
        return [path.stem for path in self._paths.values()]

    def find(self, name: str) -> str:
        """The hash of an avatar by its name or its file.

        Raises:
            OptionError: Neither; names the known ones.
            AvatarFileError: The file cannot be read.
        """
        for identity, path in self._paths.items():
            if path.stem.lower() == name.lower():
                return identity
        path = Path(name).expanduser()
        if path.suffix != SUFFIX:
            known = ", ".join(self.names) or "none"
            raise OptionError(
                f"avatar {name!r} is unknown; shipped are: {known}; or give a {SUFFIX} file"
            )
        identity = avatar_id(path)
        self._paths.setdefault(identity, path)
        return identity

    def has(self, identity: str) -> bool:
        """Whether the file is known."""
        return identity in self._paths

    def get(self, identity: str) -> Avatar | None:
        """The avatar once it is loaded: see `AvatarStore.get`."""
        if not self.has(identity):
            raise _unknown(identity)
        future = self._begin_loading(identity)
        if not future.done():
            return None
        error = future.exception()
        if isinstance(error, AvatarFileError):
            # A fresh one each time: an error raised again and again keeps every traceback.
            why = str(error).removeprefix(f"{self._paths[identity]}: ")
            raise AvatarFileError(f"avatar file is refused: {why} ({identity[:8]})") from error
        return future.result()

    def note(self, identity: str) -> str:
        """See `AvatarStore.note`; files are here or not."""
        return ""

    def add(self, identity: str, path: Path) -> None:
        """Know one more file, whose hash is known already."""
        self._paths.setdefault(identity, path)

    def path(self, identity: str) -> Path:
        """The file of an avatar that is known."""
        return self._paths[identity]

    def load(self, identity: str) -> Avatar:
        """The avatar, waiting for it.

        Raises:
            AvatarFileError: It must not be used, or no file has this hash.
        """
        if not self.has(identity):
            raise _unknown(identity)
        return self._begin_loading(identity).result()

    def close(self) -> None:
        """End the loading thread."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _begin_loading(self, identity: str) -> Future[Avatar]:
        with self._lock:
            future = self._loading.pop(identity, None)
            is_new = future is None
            if future is None:
                future = self._pool.submit(_load, self._paths[identity])
            self._loading[identity] = future  # the latest asked for is the last
            if is_new:
                self._forget()
        return future

    def _forget(self) -> None:
        """Keep no more files than `MAX_LOADED_BYTES`: those that were asked for latest, the newest
        in any case."""
        left = MAX_LOADED_BYTES
        for index, identity in enumerate(reversed(list(self._loading))):
            with suppress(OSError):  # a file that is gone takes nothing
                left -= self._paths[identity].stat().st_size
            if index and left < 0:
                del self._loading[identity]


def _unknown(identity: str) -> AvatarFileError:
    short = identity[:8] or "(none)"
    return AvatarFileError(f"avatar file is missing here: get {short} and name it with --avatar")


def _load(path: Path) -> Avatar:
    avatar = load_avatar(path)
    still_map(avatar)  # made here, so that the display need not wait for it
    return avatar
