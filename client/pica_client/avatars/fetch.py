"""Avatars that a relay has and this machine has not: fetched in a thread, kept on disk.

Wraps the library of a receiver. A face whose avatar is not there waits with a note on how far the
file is, and appears when the file has come, has its hash and is found good by `load_avatar`. One
file comes at a time: what is slow is the link. A relay that does not have a file may get it yet,
from a sender that has just joined; so it is asked again, less and less often, while the avatar is
still wanted.
"""

import hashlib
import logging
import math
import os
import ssl
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import httpx

from pica_client.avatars.library import AvatarLibrary
from pica_client.errors import RelayRefusedError, RelayUnreachableError
from pica_client.system import make_private
from pica_client.transport.connect import SOFTWARE, proxy_of
from pica_core.avatar.file import MAX_FILE_BYTES, SUFFIX, Avatar, avatar_id, load_avatar
from pica_core.errors import AvatarFileError
from pica_core.files import FOLDERS, replacing
from pica_protocol.limits import is_avatar_id
from pica_protocol.messages import AVATARS_PATH

MAX_BYTES = 2**30
"""Bytes that all files together may take (chosen: two hundred avatars of the size that ships)."""


class AvatarCache:
    """A bounded folder of avatar files by hash, by default this user's; the newest file is kept
    whatever its size. One thread uses it; processes may share it."""

    def __init__(self, folder: Path | None = None, max_bytes: int = MAX_BYTES) -> None:
        self._max_bytes = max_bytes
        self.folder = folder or FOLDERS.user_cache_path / "avatars"

    def find(self, identity: str) -> Path | None:
        """The file of an avatar, if it is there and still has its hash."""
        path = self.folder / f"{identity}{SUFFIX}"
        with suppress(AvatarFileError, OSError):
            if avatar_id(path) == identity:
                os.utime(path)
                return path
            path.unlink()
        return None

    def keep(self, identity: str, data: bytes) -> Path:
        """Write a file that has come whole, and delete those used longest ago until all fit.

        Raises:
            OSError: The file cannot be written.
        """
        make_private(self.folder)
        newest = self.folder / f"{identity}{SUFFIX}"
        with replacing(newest) as unfinished:
            unfinished.write_bytes(data)
        files = []
        for path in self.folder.iterdir():
            with suppress(OSError):  # another process deletes, too
                found = path.stat()
                files.append((found.st_mtime, found.st_size, path))
        num_too_many = sum(size for _, size, _ in files) - self._max_bytes
        for _, size, path in sorted(files):
            if num_too_many > 0 and path != newest:
                path.unlink(missing_ok=True)
                num_too_many -= size
        return newest


TIMEOUT_S = 10.0
"""Seconds that a relay has to say something."""
MAX_DOWNLOAD_S = 300.0
"""Seconds for a whole file (chosen: those that ship have 4 MB, which is 110 kbit/s)."""

Progress = Callable[[float], bool]
"""Takes the ratio that is there; returns False to stop."""


def store_url(relay_url: str, identity: str) -> str:
    """The HTTP address of an avatar at a relay."""
    parts = urlsplit(relay_url)
    scheme = {"ws": "http", "wss": "https"}[parts.scheme]
    return f"{scheme}://{parts.netloc}{parts.path.rstrip('/')}{AVATARS_PATH}{identity}"


def download(relay_url: str, identity: str, *, progress: Progress = lambda ratio: True) -> bytes:
    """Get an avatar file and check its hash; blocks.

    Args:
        relay_url: ws:// or wss://.
        progress: Called after each piece.

    Raises:
        RelayUnreachableError: It did not come.
        RelayRefusedError: It will not come.
    """
    url = store_url(relay_url, identity)
    begin_s = time.monotonic()
    data = bytearray()
    try:
        with (
            httpx.Client(
                verify=ssl.create_default_context() if url.startswith("https:") else False,
                proxy=proxy_of(relay_url),
                trust_env=False,
                timeout=TIMEOUT_S,
                headers={"User-Agent": SOFTWARE, "Accept-Encoding": "identity"},
            ) as client,
            client.stream("GET", url) as response,  # redirects are not followed
        ):
            size = _size_of(response)
            for piece in response.iter_raw():
                data += piece
                if len(data) > size:
                    raise RelayRefusedError("the file is longer than announced")
                if time.monotonic() - begin_s > MAX_DOWNLOAD_S:
                    raise RelayUnreachableError("the file arrives too slowly")
                if not progress(len(data) / size):
                    raise RelayUnreachableError("the avatar is no longer wanted")
    except (httpx.HTTPError, ImportError, ValueError) as error:  # the latter two are a proxy's
        raise RelayUnreachableError(str(error) or "the relay does not answer") from error
    if hashlib.sha256(data).hexdigest() != identity:
        raise RelayRefusedError("the relay gave another file than asked for")
    return bytes(data)


def _size_of(response: httpx.Response) -> int:
    """How long the file is that an answer holds."""
    status = response.status_code
    if status == 404:
        raise RelayUnreachableError("the relay does not have it yet")
    if status in (429, 500, 502, 503, 504):
        raise RelayUnreachableError(f"the relay answers HTTP {status}")
    if status != 200:
        raise RelayRefusedError("the relay keeps no avatars")
    size = response.headers.get("Content-Length", "")
    if not size.isdecimal():
        raise RelayUnreachableError("the relay does not say how long the file is")
    if not 0 < int(size) <= MAX_FILE_BYTES:
        raise RelayRefusedError(f"a file of {size} bytes; the limit is {MAX_FILE_BYTES}")
    return int(size)


FIRST_RETRY_S, LAST_RETRY_S = 0.5, 15.0
"""Between two attempts at one avatar, at first and in the end (chosen: a sender's file takes some
time to get to the relay; after that there is no hurry)."""
FORGOTTEN_AFTER_S = 10.0
"""An avatar that was not asked for during this time is not fetched further."""
MAX_WANTED = 256
"""Avatars on their way at once; four for each peer that a room can have."""

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class _Wanted:
    """One avatar on its way."""

    asked_s: float
    due_s: float = 0.0
    """When the relay is asked next; infinite while it is being asked."""
    retry_s: float = FIRST_RETRY_S
    note: str = "avatar is on its way"
    problem: str = ""
    """Why it will not come."""


class AvatarFetcher:
    """A library whose missing avatars come from the relay; implements `AvatarStore`.

    `get` and `note` may be called by any thread, and never wait. Whatever shows a face calls `get`
    again and again, and each call may start an attempt.
    """

    def __init__(
        self,
        library: AvatarLibrary,
        relay_url: Callable[[], str],
        *,
        cache: AvatarCache | None = None,
    ) -> None:
        """Begin.

        Args:
            library: Has what is here, and gets what has come.
            relay_url: Returns where to ask, ws:// or wss://; it may change.
            cache: Keeps what has come; this user's by default.
        """
        self._library, self._relay_url = library, relay_url
        self._cache = cache or AvatarCache()
        self._wanted: dict[str, _Wanted] = {}  # bounded by MAX_WANTED
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="avatar-fetch")
        self._is_closing = False
        self.num_fetched = 0

    def get(self, identity: str) -> Avatar | None:
        """See `AvatarStore.get`; a missing one is being fetched from now on."""
        if self._library.has(identity) or not is_avatar_id(identity):
            return self._library.get(identity)
        now = time.monotonic()
        with self._lock:
            wanted = self._wanted.get(identity)
            if wanted is None:
                while len(self._wanted) >= MAX_WANTED:
                    del self._wanted[min(self._wanted, key=lambda each: self._wanted[each].asked_s)]
                wanted = self._wanted[identity] = _Wanted(now)
            wanted.asked_s = now
            if wanted.problem:
                raise AvatarFileError(wanted.problem)
            if wanted.due_s <= now and not self._is_closing:
                wanted.due_s = math.inf
                self._pool.submit(self._work, identity, wanted)
        return None

    def note(self, identity: str) -> str:
        """How far it is on its way: see `AvatarStore.note`."""
        wanted = self._wanted.get(identity)
        return "" if wanted is None else wanted.note

    def close(self) -> None:
        """End the thread; a file that is on its way is left."""
        self._is_closing = True
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _work(self, identity: str, wanted: _Wanted) -> None:
        if not self._fetch(identity, wanted):
            wanted.due_s = time.monotonic() + wanted.retry_s
            wanted.retry_s = min(2 * wanted.retry_s, LAST_RETRY_S)

    def _fetch(self, identity: str, wanted: _Wanted) -> bool:
        """Put an avatar into the library; False if it did not come."""

        def is_wanted(ratio: float) -> bool:
            wanted.note = f"avatar is on its way ({ratio:.0%})"
            return not self._is_closing and time.monotonic() - wanted.asked_s <= FORGOTTEN_AFTER_S

        try:
            path = self._cache.find(identity)
            if path is None:
                if not is_wanted(0.0):
                    return False
                data = download(self._relay_url(), identity, progress=is_wanted)
                load_avatar(data)  # what is none would push avatars out of the cache
                path = self._cache.keep(identity, data)
                self.num_fetched += 1
        except (RelayUnreachableError, OSError) as error:
            wanted.note = f"avatar file is missing: {error}"
            return False
        except (RelayRefusedError, AvatarFileError) as error:
            why = str(error).removeprefix("avatar: ")
            why = f"avatar file is missing: {why}; get {identity[:8]} and name it with --avatar"
            wanted.note = wanted.problem = why
            return False
        except Exception as error:  # a malformed file must not keep others from being fetched
            _log.warning("an avatar cannot be read", extra={"error": type(error).__name__})
            wanted.note = wanted.problem = "avatar file cannot be read"
            return False
        # Into the library first: a reader that finds it done must find the file.
        self._library.add(identity, path)
        with self._lock:
            self._wanted.pop(identity, None)
        return True
