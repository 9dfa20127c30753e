"""What a command asks of the system: a user's folders, a display, signals to end by, output files.

Folders are private: cached avatars tell whom a user met, and preferences where. Output files are
refused at a command's start where that can be known, and with one wording where it comes out later.
"""

import os
import signal
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Self

from pica_client.errors import OptionError
from pica_protocol.limits import printable


class Closing(ABC):
    """Something that a ``with`` block closes at its end."""

    @abstractmethod
    def close(self) -> object:
        """Give back what it holds."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


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


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Let what the system says against writing `path` name it.

    Raises:
        OptionError: The block met an `OSError`.
    """
    try:
        yield
    except OSError as error:
        raise OptionError(f"{path}: cannot be written: {error.strerror or error}") from error


def check_writable(path: Path | None) -> None:
    """Refuse before the work what could not be written after it. Leaves all as it was.

    Args:
        path: The file; None: there will be none.

    Raises:
        OptionError: A folder stands there, its folder is not there, or it is not ours to write.
    """
    if path is not None:
        is_new = not path.exists()
        with writing(path):
            path.open("ab").close()
        if is_new:
            path.unlink()


def say(text: str) -> None:
    """Tell the user something; results for programs go to stdout, all else here."""
    print(printable(text), file=sys.stderr, flush=True)
