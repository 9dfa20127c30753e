"""Getting one avatar file from a relay's store: by HTTP, in a thread, going on where it broke off.

The file is known by its hash, so it does not matter who gives it, or in how many pieces.
"""

import hashlib
import re
import ssl
import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO
from urllib.parse import urlsplit

import httpx

from pica_client.errors import RelayError
from pica_client.transport.connect import SOFTWARE, is_loopback
from pica_core.avatar.file import MAX_FILE_BYTES
from pica_protocol.store import AVATARS_PATH

TIMEOUT_S = 10.0
"""Seconds that a relay has to say something."""
SLOWEST_BYTES_PER_S = 1024.0
"""A file that comes more slowly than this, after `TIMEOUT_S`, is given up for now."""
MAX_RESUMES = 8
"""Pieces in which one attempt may come; each must have brought something."""

Progress = Callable[[float], bool]
"""Takes the ratio that is there; returns False to stop."""


class DownloadError(RelayError):
    """The file did not come."""


class NotThereError(DownloadError):
    """The relay does not have it, or not yet."""


class NoStoreError(DownloadError):
    """What answers there keeps no avatars."""


class WrongFileError(DownloadError):
    """What came is not the file that was asked for."""


class StoppedError(DownloadError):
    """It is not wanted any more."""


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
        tls: Whom to trust with wss://; the system's certificates by default.

    Raises:
        DownloadError: One of its kinds; ``into`` may hold a part then.
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
                # Redirects are not followed: a relay redirects nobody; what does is something else.
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
            raise WrongFileError("the relay gave another file than the one it was asked for")

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
            raise NotThereError("the relay does not have it")
        elif response.status_code in (429, 500, 502, 503, 504):
            raise DownloadError(f"the relay answers HTTP {response.status_code}")
        else:
            raise NoStoreError("the relay keeps no avatars")
        if size is None:
            raise DownloadError("the relay does not say how long the file is")
        self._size = int(size)
        if not 0 < self._size <= MAX_FILE_BYTES:
            raise WrongFileError(f"a file of {self._size} bytes; the limit is {MAX_FILE_BYTES}")

    def take(self, data: bytes) -> None:
        """Take the next bytes."""
        self.received += len(data)
        if self.received > self._size:
            raise WrongFileError("the file is longer than was said")
        self._hash.update(data)
        self._file.write(data)
        elapsed_s = time.monotonic() - self._begin_s
        if elapsed_s > TIMEOUT_S + self.received / SLOWEST_BYTES_PER_S:
            raise DownloadError("it comes too slowly")
        if not self._progress(self.received / self._size):
            raise StoppedError("not wanted any more")
