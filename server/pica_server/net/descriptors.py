"""File descriptors: as many as the system gives, and one line that says so when they run out."""

import errno
import logging
from collections import Counter
from typing import Final

RESERVED: Final = 16
"""Descriptors that are for the relay's own files, and for those sockets that are told no
(chosen)."""
SAYING_S: Final = 10.0
"""Between two lines that say it."""
_UNLIMITED: Final = 1 << 30

_logger = logging.getLogger(__name__)


def most_descriptors() -> int:
    """Raise this process's limit as far as it may, and return it."""
    try:
        import resource
    except ModuleNotFoundError:  # Windows has no such limit
        return _UNLIMITED
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
            soft = hard
        except (OSError, ValueError):  # some systems say "unlimited" and mean less
            pass
    return _UNLIMITED if soft == resource.RLIM_INFINITY else soft


class Descriptors:
    """Notices when a relay is short of descriptors."""

    def __init__(self, limit: int, limits_hit: Counter[str]) -> None:
        """Begin; ``limits_hit`` is where it is counted, as ``descriptors``."""
        self._limit = limit
        self._limits_hit = limits_hit
        self._said_s = float("-inf")

    def has_room_for(self, number: int, now: float) -> bool:
        """Return True if a socket with this descriptor may stay: the system gives the lowest."""
        if number < self._limit - RESERVED:
            return True
        self._note(now)
        return False

    def note_error(self, error: object, now: float) -> bool:
        """Return True if an error means that there are none left; if so, it is said."""
        is_short = isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE)
        if is_short:
            self._note(now)
        return is_short

    def _note(self, now: float) -> None:
        self._limits_hit["descriptors"] += 1
        if now - self._said_s >= SAYING_S:
            self._said_s = now
            _logger.warning(
                "out of file descriptors: raise `ulimit -n`, or lower --max-connections",
                extra={"limit": self._limit},
            )
