"""What a command asks of the system: a user's folders, a display, signals to end by.

Folders are private: cached avatars tell whom a user met, and preferences where.
"""

import os
import signal
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, Self

from platformdirs import PlatformDirs

_NAME: Final = "pica-telepresence"
_TITLE: Final = "PiCA Telepresence"


class Closing(ABC):
    """Something that a ``with`` block closes at its end."""

    @abstractmethod
    def close(self) -> object:
        """Give back what it holds."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def cache_folder(system: type[PlatformDirs] = PlatformDirs) -> Path:
    """Return the folder for avatars that can be fetched again."""
    return system(_NAME, appauthor=False).user_cache_path / "avatars"


def models_folder() -> Path:
    """Return the folder for networks that this user has fetched."""
    return PlatformDirs(_NAME, appauthor=False).user_data_path / "models"


def videos_folder() -> Path:
    """Return the folder for recordings that this user makes of a call."""
    return PlatformDirs(_NAME, appauthor=False).user_videos_path / _TITLE


def preferences_folder(system: type[PlatformDirs] = PlatformDirs) -> Path:
    """Return the folder for this user's preferences."""
    return system(_NAME, appauthor=False, roaming=True).user_config_path


def make_private(folder: Path) -> None:
    """Make a folder that its owner alone can look into, or change one that is there.

    Raises:
        OSError: The system refuses.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with suppress(PermissionError):  # another user's: the files in it are still private
        folder.chmod(0o700)


def has_display() -> bool:
    """Return True off Linux; on Linux, True if the environment names a display server."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@contextmanager
def on_stop_signal(stop: Callable[[], object]) -> Iterator[None]:
    """Call `stop` on SIGINT and SIGTERM while the block runs; main thread only.

    A second Ctrl-C must not cost the report. The third is a `KeyboardInterrupt`, should anything
    hang; and after the block, when all that is left is to print, further signals are ignored.

    `signal.signal` and not a method of the event loop: the latter is missing on Windows.
    """
    num_stops = 0

    def note(*_: object) -> None:
        nonlocal num_stops
        num_stops += 1
        if num_stops > 2:
            raise KeyboardInterrupt
        stop()

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, note) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, signal.SIG_IGN if num_stops else handler)


@contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """Let SIGTERM unwind like Ctrl-C while the block runs, so that ``with`` blocks clean up."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
