"""Avatars that a relay has and this machine has not: fetched in a thread, kept on disk.

Wraps the library of a receiver. A peer whose avatar is not there makes it be fetched; the face
waits with a note on how far it is, and appears when the file has come, has its hash and is found
good by `load_avatar`. One file comes at a time: what is slow is the link. A relay that does not
have a file may get it yet, from a sender that has just joined; so it is asked again, less and less
often, while the avatar is still wanted.
"""

import hashlib
import logging
import os
import re
import secrets
import ssl
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO
from urllib.parse import urlsplit

import httpx

from pica_client.avatars.library import AvatarLibrary
from pica_client.errors import RelayError
from pica_client.transport.connect import SOFTWARE, is_loopback
from pica_client.user_folders import cache_folder, make_private
from pica_core.avatar.file import MAX_FILE_BYTES, Avatar, avatar_id, load_avatar
from pica_core.errors import AvatarFileError
from pica_protocol.store import AVATARS_PATH, is_avatar_id

MAX_BYTES = 2**30
"""Bytes that all files together may take (chosen: four hundred avatars of the size that ships)."""
SUFFIX = ".pica"
UNFINISHED = ".part"
ABANDONED_AFTER_S = 86_400.0


class AvatarCache:
    """A bounded folder of avatar files by hash. One thread uses it; processes may share it."""

    def __init__(self, folder: Path | None = None, max_bytes: int = MAX_BYTES) -> None:
        """Prepare the folder, by default `cache_folder`; one that cannot be written is replaced by
        a temporary one. The newest file is kept whatever its size.
        """
        self._max_bytes = max_bytes
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self.folder = cache_folder() if folder is None else folder
        try:
            if folder is None:
                make_private(self.folder)
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            trial = self.unfinished("trial")
            trial.touch()
            trial.unlink()
            for path in self.folder.glob(f"*{UNFINISHED}"):
                with suppress(OSError):
                    if time.time() - path.stat().st_mtime > ABANDONED_AFTER_S:
                        path.unlink()
        except OSError:
            self._temporary = tempfile.TemporaryDirectory(prefix="pica-cache-")
            self.folder = Path(self._temporary.name)

    def find(self, identity: str) -> Path | None:
        """The file of an avatar, if it is there and still has its hash."""
        path = self._path(identity)
        try:
            if avatar_id(path) == identity:
                os.utime(path)
                return path
        except (AvatarFileError, OSError):
            pass
        with suppress(OSError):
            path.unlink(missing_ok=True)
        return None

    def unfinished(self, identity: str) -> Path:
        """A new path for a file that is on its way."""
        return self.folder / f"{identity[:16]}-{secrets.token_hex(8)}{UNFINISHED}"

    def keep(self, unfinished: Path, identity: str) -> Path:
        """Take a file that has come whole, and make room for it; OSError if it cannot be moved."""
        path = self._path(identity)
        os.replace(unfinished, path)
        self._trim(path)
        return path

    def close(self) -> None:
        """Delete what was only temporary."""
        if self._temporary is not None:
            self._temporary.cleanup()

    def _path(self, identity: str) -> Path:
        return self.folder / f"{identity}{SUFFIX}"

    def _trim(self, newest: Path) -> None:
        files = []
        for path in self.folder.glob(f"*{SUFFIX}"):
            with suppress(OSError):  # another process trims, too
                found = path.stat()
                files.append((path == newest, found.st_mtime, found.st_size, path))
        num_too_many = sum(size for _, _, size, _ in files) - self._max_bytes
        for is_newest, _, size, path in sorted(files):
            if num_too_many <= 0 or is_newest:
                return
            with suppress(OSError):
                path.unlink()
            num_too_many -= size


TIMEOUT_S = 10.0
"""Seconds that a relay has to say something."""
SLOWEST_BYTES_PER_S = 1024.0
"""A file that comes more slowly than this, after `TIMEOUT_S`, is given up for now."""
MAX_RESUMES = 8
"""Pieces in which one attempt may come; each must have brought something."""

Progress = Callable[[float], bool]
"""Takes the ratio that is there; returns False to stop."""


class DownloadError(RelayError):
    """The file did not come; `is_final`: asking again will not help."""

    def __init__(self, message: str, *, is_final: bool = False) -> None:
        super().__init__(message)
        self.is_final = is_final


def store_url(relay_url: str, identity: str) -> str:
    """The HTTP address of an avatar at a relay."""
    parts = urlsplit(relay_url)
    scheme = {"ws": "http", "wss": "https"}[parts.scheme]
    return f"{scheme}://{parts.netloc}{parts.path.rstrip('/')}{AVATARS_PATH}{identity}"


def download(
    relay_url: str,
    identity: str,
    into: Path,
    *,
    progress: Progress = lambda ratio: True,
    tls: ssl.SSLContext | None = None,
) -> None:
    """Get an avatar file and check its hash; blocks.

    Args:
        relay_url: ws:// or wss://.
        into: A file that is not there yet.
        progress: Called after each piece.
        tls: Certificates for wss://; the system's by default.

    Raises:
        DownloadError: It did not come; ``into`` may hold a part then.
        OSError: ``into`` cannot be written.
    """
    url = store_url(relay_url, identity)
    is_secure = url.startswith("https:")
    try:
        client = httpx.Client(
            verify=(tls or ssl.create_default_context()) if is_secure else False,
            trust_env=not is_loopback(urlsplit(url).hostname or ""),  # for proxies
            timeout=TIMEOUT_S,
            headers={"User-Agent": SOFTWARE, "Accept-Encoding": "identity"},
        )
    except (ImportError, ValueError) as error:
        raise DownloadError(f"the proxy of the environment cannot be used: {error}") from error
    with client, into.open("xb") as file:
        transfer = _Transfer(identity, file, progress)
        for _ in range(MAX_RESUMES):
            before = transfer.received
            try:
                # Redirects are not followed: a relay never redirects.
                with client.stream("GET", url, headers=transfer.conditions) as response:
                    transfer.begin(response)
                    for data in response.iter_raw():
                        transfer.take(data)
            except httpx.TransportError as error:
                # A connection that broke in the middle can be gone on with.
                if not transfer.received:
                    raise DownloadError(str(error) or "no answer") from error
            if transfer.is_complete:
                break
            if transfer.received == before:
                raise DownloadError("the relay closed the connection")
        else:
            raise DownloadError("the connection broke too often")
    transfer.check()


class _Transfer:
    """A file on its way, in as many answers as it takes."""

    def __init__(self, identity: str, file: BinaryIO, progress: Progress) -> None:
        self._identity, self._file, self._progress = identity, file, progress
        self._hash = hashlib.sha256()
        self._size = 0
        self.received = 0
        self._begin_s = time.monotonic()

    @property
    def is_complete(self) -> bool:
        return 0 < self._size == self.received

    @property
    def conditions(self) -> dict[str, str]:
        """The headers that ask for what is missing."""
        if not self.received:
            return {}
        return {"Range": f"bytes={self.received}-", "If-Range": f'"{self._identity}"'}

    def check(self) -> None:
        if self._hash.hexdigest() != self._identity:
            raise DownloadError("the relay gave another file than asked for", is_final=True)

    def begin(self, response: httpx.Response) -> None:
        """Take the head of an answer."""
        if response.status_code == 206:
            text = response.headers.get("Content-Range", "")
            found = re.fullmatch(r"bytes (\d{1,18})-\d{1,18}/(\d{1,18})", text)
            if found is not None and int(found[1]) != self.received:
                raise DownloadError("the relay gave another range than the one asked for")
            size = found and found[2]
        elif response.status_code == 200:
            self._hash = hashlib.sha256()
            self.received = 0
            self._file.seek(0)
            self._file.truncate()
            size = response.headers.get("Content-Length")
        elif response.status_code == 404:
            raise DownloadError("the relay does not have it yet")
        elif response.status_code in (429, 500, 502, 503, 504):
            raise DownloadError(f"the relay answers HTTP {response.status_code}")
        else:
            raise DownloadError("the relay keeps no avatars", is_final=True)
        if size is None:
            raise DownloadError("the relay does not say how long the file is")
        self._size = int(size)
        if not 0 < self._size <= MAX_FILE_BYTES:
            why = f"a file of {self._size} bytes; the limit is {MAX_FILE_BYTES}"
            raise DownloadError(why, is_final=True)

    def take(self, data: bytes) -> None:
        """Take the next bytes."""
        self.received += len(data)
        if self.received > self._size:
            raise DownloadError("the file is longer than was said", is_final=True)
        self._hash.update(data)
        self._file.write(data)
        elapsed_s = time.monotonic() - self._begin_s
        if elapsed_s > TIMEOUT_S + self.received / SLOWEST_BYTES_PER_S:
            raise DownloadError("it comes too slowly")
        if not self._progress(self.received / self._size):
            raise DownloadError("not wanted any more")


FIRST_RETRY_S = 0.5
LAST_RETRY_S = 15.0
"""Between two attempts at one avatar, at first and in the end (chosen: a sender's file takes some
time to get to the relay; after that there is no hurry)."""
FORGOTTEN_AFTER_S = 10.0
"""An avatar that was not asked for during this time is not fetched further."""
MAX_WANTED = 256
"""Avatars on their way at once; four for each peer that a room can have."""
JOIN_TIMEOUT_S = 1.0

_log = logging.getLogger(__name__)


@dataclass(kw_only=True, slots=True)
class _Wanted:
    """One avatar on its way."""

    asked_s: float
    due_s: float
    retry_s: float = FIRST_RETRY_S
    note: str = ""
    problem: str = ""
    """Why it will not come."""


class AvatarFetcher:
    """A library whose missing avatars come from the relay; implements `AvatarStore`.

    `get` and `note` may be called by any thread, and never wait.
    """

    def __init__(
        self,
        library: AvatarLibrary,
        relay_url: Callable[[], str],
        *,
        cache: AvatarCache | None = None,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        """Begin; the thread starts with the first avatar that is missing.

        Args:
            library: Has what is here, and gets what has come.
            relay_url: Returns where to ask, ws:// or wss://; it may change.
            cache: Keeps what has come; this user's by default.
        """
        self._library = library
        self._relay_url = relay_url
        self._cache = cache
        self._tls = tls
        self._wanted: dict[str, _Wanted] = {}  # bounded by MAX_WANTED
        self._changed = threading.Condition()
        self._is_closing = False
        self._thread: threading.Thread | None = None
        self.num_fetched = 0

    def has(self, identity: str) -> bool:
        """Whether the library has it, or the relay may: see `AvatarStore.has`."""
        return self._library.has(identity) or is_avatar_id(identity)

    def get(self, identity: str) -> Avatar | None:
        """See `AvatarStore.get`; a missing one is being fetched from now on."""
        if self._library.has(identity):
            return self._library.get(identity)
        if not is_avatar_id(identity):
            return None
        now = time.monotonic()
        with self._changed:
            wanted = self._wanted.get(identity)
            if wanted is None:
                self._begin(identity, now)
                return None
            if now - wanted.asked_s > FORGOTTEN_AFTER_S:
                self._changed.notify()  # it was left alone meanwhile
            wanted.asked_s = now
            if wanted.problem:
                raise AvatarFileError(wanted.problem)
        return None

    def note(self, identity: str) -> str:
        """How far it is on its way: see `AvatarStore.note`."""
        with self._changed:
            wanted = self._wanted.get(identity)
            return "" if wanted is None else wanted.note

    def close(self) -> None:
        """End the thread; a file that is on its way is left."""
        with self._changed:
            self._is_closing = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(JOIN_TIMEOUT_S)

    def _begin(self, identity: str, now: float) -> None:
        while len(self._wanted) >= MAX_WANTED:
            oldest = min(self._wanted, key=lambda each: self._wanted[each].asked_s)
            del self._wanted[oldest]
        self._wanted[identity] = _Wanted(asked_s=now, due_s=now, note="avatar is on its way")
        if self._thread is None and not self._is_closing:
            self._thread = threading.Thread(target=self._work, name="avatar-fetch", daemon=True)
            self._thread.start()
        self._changed.notify()

    def _work(self) -> None:
        cache = self._cache or AvatarCache()
        try:
            while (identity := self._next()) is not None:
                path = cache.find(identity) or self._download(cache, identity)
                if path is not None:
                    # Into the library first: a reader that finds it done must find the file.
                    self._library.add(identity, path)
                    with self._changed:
                        self._wanted.pop(identity, None)
        finally:
            cache.close()

    def _next(self) -> str | None:
        """Wait for an avatar that is due; None at the end."""
        with self._changed:
            while not self._is_closing:
                now = time.monotonic()
                open_ones = [
                    (wanted.due_s, identity)
                    for identity, wanted in self._wanted.items()
                    if not wanted.problem and now - wanted.asked_s <= FORGOTTEN_AFTER_S
                ]
                if open_ones and min(open_ones)[0] <= now:
                    return min(open_ones)[1]
                self._changed.wait(min(open_ones)[0] - now if open_ones else None)
        return None

    def _download(self, cache: AvatarCache, identity: str) -> Path | None:
        unfinished = cache.unfinished(identity)
        try:
            download(
                self._relay_url(),
                identity,
                unfinished,
                progress=lambda ratio: self._note_progress(identity, ratio),
                tls=self._tls,
            )
            load_avatar(unfinished)  # what is none would push avatars out of the cache
            path = cache.keep(unfinished, identity)
            self.num_fetched += 1
            return path
        except (DownloadError, AvatarFileError, OSError) as error:
            is_final = isinstance(error, AvatarFileError) or getattr(error, "is_final", False)
            why = str(error).removeprefix(f"{unfinished}: ")
            if is_final:
                why += f"; get {identity[:8]} and name it with --avatar"
            self._note_failure(identity, f"avatar file is missing: {why}", is_final=is_final)
        except Exception as error:  # a malformed file must not keep others from being fetched
            _log.warning("an avatar cannot be read", extra={"error": type(error).__name__})
            self._note_failure(identity, "avatar file cannot be read", is_final=True)
        finally:
            with suppress(OSError):
                unfinished.unlink(missing_ok=True)
        return None

    def _note_progress(self, identity: str, ratio: float) -> bool:
        with self._changed:
            wanted = self._wanted.get(identity)
            if wanted is None or self._is_closing:
                return False
            wanted.note = f"avatar is on its way ({ratio:.0%})"
            return time.monotonic() - wanted.asked_s <= FORGOTTEN_AFTER_S

    def _note_failure(self, identity: str, note: str, *, is_final: bool = False) -> None:
        with self._changed:
            wanted = self._wanted.get(identity)
            if wanted is not None:
                wanted.note = note
                wanted.problem = note if is_final else ""
                wanted.due_s = time.monotonic() + wanted.retry_s
                wanted.retry_s = min(2 * wanted.retry_s, LAST_RETRY_S)
