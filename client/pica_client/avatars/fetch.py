"""Avatars that a relay has and this machine has not: fetched in a thread, kept on disk.

Wraps the library of a receiver. A peer whose avatar is not there makes it be fetched; the face
waits with a note on how far it is, and appears when the file has come, has its hash and is found
good by `load_avatar`. One file comes at a time: what is slow is the link. A relay that does not
have a file may get it yet, from a sender that has just joined; so it is asked again, less and less
often, while somebody still wants the avatar.
"""

import logging
import ssl
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pica_client.avatars.cache import AvatarCache
from pica_client.avatars.download import (
    DownloadError,
    NoStoreError,
    NotThereError,
    StoppedError,
    WrongFileError,
    download,
)
from pica_client.avatars.library import AvatarLibrary
from pica_core.avatar.file import Avatar, load_avatar
from pica_core.errors import AvatarFileError
from pica_protocol.store import is_avatar_id

FIRST_RETRY_S = 0.5
LAST_RETRY_S = 15.0
"""Between two attempts at one avatar, at first and in the end (chosen: a sender's file takes some
time to get to the relay; who is not helped by then is in no hurry)."""
FORGOTTEN_AFTER_S = 10.0
"""An avatar that nobody has asked for during this time is not fetched further."""
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
                    # Into the library first: whoever finds it done there must find the file.
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
        except NotThereError:
            self._note_failure(identity, "avatar file is missing: the relay does not have it yet")
        except (NoStoreError, WrongFileError, AvatarFileError) as error:
            why = str(error).removeprefix(f"{unfinished}: ")
            problem = f"avatar file is missing: {why}; get {identity[:8]} and name it with --avatar"
            self._note_failure(identity, problem, is_final=True)
        except StoppedError:
            pass
        except (DownloadError, OSError) as error:
            _log.debug("avatar not fetched", extra={"error": type(error).__name__})
            self._note_failure(identity, "avatar file does not come; trying again")
        except Exception as error:  # whatever a stranger's file does, others are fetched after it
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
