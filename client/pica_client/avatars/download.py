"""Getting one avatar file from a relay's store: by HTTP, in a thread, going on where it broke off.

The file is known by its hash, so it does not matter who gives it, or in how many pieces.
"""

from __future__ import annotations

import hashlib
import ssl
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from http.client import HTTPException, HTTPMessage
from pathlib import Path
from typing import IO, Any, BinaryIO
from urllib.parse import urlsplit

from pica_client.errors import RelayError
from pica_client.transport.connect import SOFTWARE, is_loopback
from pica_core.avatar.file import MAX_FILE_BYTES
from pica_protocol.store import AVATARS_PATH

TIMEOUT_S = 10.0
"""For a relay to say something."""
SLOWEST_BYTES_PER_S = 1024.0
"""A file that comes more slowly than this, after `TIMEOUT_S`, is given up for now."""
PIECE_BYTES = 16 * 2**10
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
        relay_url: Of the relay, ws:// or wss://.
        identity: SHA-256 of the file.
        into: A file that is not there yet.
        progress: Called after each piece.
        tls: Whom to trust with wss://; the system's certificates by default.

    Raises:
        DownloadError: One of its kinds; ``into`` may hold a part then.
        OSError: ``into`` cannot be written.
    """
    with into.open("xb") as file:
        transfer = _Transfer(store_url(relay_url, identity), identity, file, progress, tls)
        for _ in range(MAX_RESUMES):
            before = transfer.received
            transfer.go_on()
            if transfer.is_complete:
                break
            if transfer.received == before:
                raise DownloadError("the relay closed the connection")
        else:
            raise DownloadError("the connection broke too often")
    transfer.check()


class _Transfer:
    def __init__(
        self,
        url: str,
        identity: str,
        file: BinaryIO,
        progress: Progress,
        tls: ssl.SSLContext | None,
    ) -> None:
        self._url, self._identity, self._file, self._progress = url, identity, file, progress
        handlers: list[urllib.request.BaseHandler] = [urllib.request.HTTPSHandler(context=tls)]
        if is_loopback(urlsplit(url).hostname or ""):
            handlers.append(urllib.request.ProxyHandler({}))
        self._opener = urllib.request.build_opener(_NoRedirects(), *handlers)
        self._hash = hashlib.sha256()
        self._size: int | None = None
        self.received = 0
        self._begin_s = time.monotonic()

    @property
    def is_complete(self) -> bool:
        return self.received == self._size

    def check(self) -> None:
        if self._hash.hexdigest() != self._identity:
            raise WrongFileError("the relay gave another file than the one it was asked for")

    def go_on(self) -> None:
        """Ask for what is missing, and take it until the connection ends."""
        headers = {"User-Agent": SOFTWARE, "Accept-Encoding": "identity"}
        if self.received:
            headers |= {"Range": f"bytes={self.received}-", "If-Range": f'"{self._identity}"'}
        request = urllib.request.Request(self._url, headers=headers)
        try:
            with self._opener.open(request, timeout=TIMEOUT_S) as response:
                self._note_size(response.status, response.headers)
                while not self.is_complete:
                    data = response.read1(PIECE_BYTES)
                    if not data:
                        return
                    self._take(data)
        except urllib.error.HTTPError as error:
            with error:
                raise _refusal(error.code) from error
        except (OSError, HTTPException) as error:
            if isinstance(error, _DiskError):
                raise error.__cause__ or error from None
            # A connection that broke in the middle can be gone on with.
            if not self.received:
                raise DownloadError(str(error) or "no answer") from error

    def _note_size(self, status: int, headers: HTTPMessage) -> None:
        if status == 200 and self.received:
            self._hash = hashlib.sha256()
            self.received = 0
            self._file.seek(0)
            self._file.truncate()
        try:
            if status == 206:
                text = str(headers["Content-Range"])
                begin, _, size = text.removeprefix("bytes ").replace("/", "-").split("-")
                if int(begin) != self.received:
                    raise DownloadError("the relay gave another range than the one asked for")
                self._size = int(size)
            else:
                self._size = int(str(headers["Content-Length"]))
        except ValueError as error:
            raise DownloadError("the relay does not say how long the file is") from error
        if not 0 < self._size <= MAX_FILE_BYTES:
            raise WrongFileError(f"a file of {self._size} bytes; the limit is {MAX_FILE_BYTES}")

    def _take(self, data: bytes) -> None:
        assert self._size is not None
        self.received += len(data)
        if self.received > self._size:
            raise WrongFileError("the file is longer than was said")
        self._hash.update(data)
        try:
            self._file.write(data)
        except OSError as error:
            raise _DiskError from error
        elapsed_s = time.monotonic() - self._begin_s
        if elapsed_s > TIMEOUT_S + self.received / SLOWEST_BYTES_PER_S:
            raise DownloadError("it comes too slowly")
        if not self._progress(self.received / self._size):
            raise StoppedError("not wanted any more")


class _DiskError(OSError):
    """Ours, and not the network's."""


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """A relay redirects nobody; what does is something else."""

    def redirect_request(
        self,
        req: urllib.request.Request,
        fp: IO[bytes],
        code: int,
        msg: str,
        headers: HTTPMessage,
        newurl: str,
    ) -> Any:
        return None


def _refusal(status: int) -> DownloadError:
    if status == 404:
        return NotThereError("the relay does not have it")
    if status in (429, 500, 502, 503, 504):
        return DownloadError(f"the relay answers HTTP {status}")
    return NoStoreError("the relay keeps no avatars")
