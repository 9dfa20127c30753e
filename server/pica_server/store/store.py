"""The avatar store: files by the SHA-256 of their bytes, so that a stranger can be seen by all.

Receivers hash and check what they get, and so need not trust the relay. The store takes care of how
much it takes; what is inside of a file is not looked at. A file is there under its final name whole
or not at all. Names are made of an id that was checked to be 64 hexadecimal digits, and of nothing
else.

What blocks happens in threads of the store. It knows no websocket; `transfers` are the
ways in and out.
"""

import asyncio
import errno
import hashlib
import os
import secrets
import stat
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, TypeVar

from pica_protocol.errors import CloseCode
from pica_protocol.limits import is_avatar_id
from pica_server.config import ConfigurationError, StoreConfig
from pica_server.limits import RefusalError

NUM_THREADS: Final = 4
SUFFIX: Final = ".pica"
TEMPORARY: Final = "temporary"
"""Names a folder that ends with the relay."""

_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_T = TypeVar("_T")


class Slots:
    """Counts what goes on at the same time, in all and for each address."""

    def __init__(self, limit: int, per_address: int) -> None:
        self._limit = limit
        self._per_address = per_address
        self._by_address: Counter[str] = Counter()  # bounded by the limit

    @contextmanager
    def taken(self, address: str) -> Iterator[None]:
        """Hold one; an empty address has no limit of its own.

        Raises:
            RefusalError: There is none.
        """
        is_many = bool(address) and self._by_address[address] >= self._per_address
        if is_many or self._by_address.total() >= self._limit:
            raise RefusalError("too many at once, try again", CloseCode.BUSY)
        self._by_address[address] += 1
        try:
            yield
        finally:
            self._by_address[address] -= 1
            self._by_address += Counter()  # drops those that hold none


class AvatarStore:
    """Files by id in one folder, within a quota; and those that ship."""

    def __init__(self, where: str, config: StoreConfig, shipped: Sequence[Path] = ()) -> None:
        """Look what is there.

        Args:
            where: A folder, or ``temporary``.
            shipped: Files that are given as well, and count nowhere.

        Raises:
            ConfigurationError: The folder cannot be used, or holds more files than it may.
        """
        self.config = config
        self._temporary: TemporaryDirectory[str] | None = None
        if where == TEMPORARY:
            self._temporary = TemporaryDirectory(prefix="pica-avatars-")
            where = self._temporary.name
        self._folder = Path(where).expanduser().absolute()
        self._sizes: dict[str, int] = {}  # bounded by max_avatars
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._write("trial", b"trial")
            (self._folder / "trial").unlink()
            for identity in (path.stem for path in self._folder.glob(f"*{SUFFIX}")):
                if is_avatar_id(identity) and (size := self._size(identity)) is not None:
                    self._sizes[identity] = size
        except OSError as error:
            raise ConfigurationError(
                f"--avatar-store {where} cannot be written: {error.strerror or error}; "
                "give the relay a folder of its own, or none"
            ) from error
        if len(self._sizes) > config.max_avatars:
            raise ConfigurationError(
                f"--avatar-store {where} holds more than {config.max_avatars} avatars; "
                "raise --store.max-avatars, or remove some"
            )
        self._reserved_bytes = self._num_reserved = 0
        self._shipped = shipped
        self._threads = ThreadPoolExecutor(NUM_THREADS, thread_name_prefix="avatar-store")

    @property
    def num_avatars(self) -> int:
        """Files that it knows of."""
        return len(self._sizes)

    @property
    def used_bytes(self) -> int:
        """Bytes of all files that it knows of."""
        return sum(self._sizes.values())

    @property
    def num_free_bytes(self) -> int:
        """Bytes that an offer may still have."""
        return self.config.quota_bytes - self.used_bytes - self._reserved_bytes

    async def size(self, identity: str) -> int | None:
        """Return a file's size, or None if it is not there; asks the folder, which others may
        share.

        Raises:
            OSError: The folder does not answer.
        """
        size = await self._in_thread(lambda: self._size(identity))
        if size is None:
            self._sizes.pop(identity, None)
            return await self._in_thread(lambda: self._size_that_ships(identity))
        if len(self._sizes) < self.config.max_avatars:
            self._sizes[identity] = size
        return size

    async def read(self, identity: str, begin: int, end: int) -> bytes:
        """Return a part of a file.

        Raises:
            OSError: It is not there any more, or shorter.
        """

        def read() -> bytes:
            path = self._path(identity)
            if identity not in self._sizes:
                path = self._shipped_by_id.get(identity, path)
            with path.open("rb") as file:
                file.seek(begin)
                return file.read(end - begin)

        data = await self._in_thread(read)
        if len(data) != end - begin:
            raise OSError(errno.EIO, "a file is shorter than it was")
        return data

    @contextmanager
    def reserved(self, size: int) -> Iterator[None]:
        """Hold room for a file while the block runs.

        Raises:
            RefusalError: There is none.
        """
        config, why = self.config, ""
        if size > config.largest_bytes:
            why = f"{size} bytes, it takes no file above {config.largest_bytes}"
        elif len(self._sizes) + self._num_reserved >= config.max_avatars:
            why = f"it has {config.max_avatars} avatars, the most it may"
        elif size > self.num_free_bytes:
            why = f"its {config.quota_bytes} bytes are taken"
        if why:
            raise RefusalError(why, CloseCode.STORE_FULL)
        self._reserved_bytes += size
        self._num_reserved += 1
        try:
            yield
        finally:
            self._reserved_bytes -= size
            self._num_reserved -= 1

    async def keep(self, identity: str, data: bytes | bytearray) -> None:
        """Keep a whole file.

        Raises:
            RefusalError: It has another SHA-256, or the disk is full.
            OSError: It cannot be written.
        """

        def check_and_keep() -> None:
            if hashlib.sha256(data).hexdigest() != identity:
                reason = "its SHA-256 is not the one that was offered"
                raise RefusalError(reason, CloseCode.UNFIT_FILE)
            self._write(self._path(identity).name, data)

        try:
            await self._in_thread(check_and_keep)
        except OSError as error:
            if error.errno in _NO_ROOM:
                raise RefusalError("its disk is full", CloseCode.STORE_FULL) from error
            raise
        self._sizes[identity] = len(data)

    def close(self) -> None:
        """End the threads, and delete what was temporary."""
        self._threads.shutdown(wait=True, cancel_futures=True)
        if self._temporary is not None:
            self._temporary.cleanup()

    def _path(self, identity: str) -> Path:
        if not is_avatar_id(identity):
            raise ValueError("nothing but an id is ever joined to a path")
        return self._folder / f"{identity}{SUFFIX}"

    def _size(self, identity: str) -> int | None:
        """Return a file's size; None if it is not there, or leads elsewhere as a link does."""
        with suppress(FileNotFoundError):
            status = self._path(identity).lstat()
            return status.st_size if stat.S_ISREG(status.st_mode) else None
        return None

    def _size_that_ships(self, identity: str) -> int | None:
        path = self._shipped_by_id.get(identity)
        return None if path is None else path.stat().st_size

    @cached_property
    def _shipped_by_id(self) -> dict[str, Path]:
        return {hashlib.sha256(path.read_bytes()).hexdigest(): path for path in self._shipped}

    def _write(self, name: str, data: bytes | bytearray) -> None:
        """Write a whole file."""
        unfinished = self._folder / f"{secrets.token_hex(16)}.part"
        try:
            with unfinished.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())  # else a crash could leave a whole name on half a file
            unfinished.replace(self._folder / name)
        finally:
            unfinished.unlink(missing_ok=True)

    async def _in_thread(self, action: Callable[[], _T]) -> _T:
        return await asyncio.get_running_loop().run_in_executor(self._threads, action)
