"""Files that a command writes: refused at its start where that can be known, and with one wording
where it comes out later."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pica_client.errors import OptionError


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


def check_writable(path: Path) -> None:
    """Refuse before the work what could not be written after it. Writes nothing.

    Raises:
        OptionError: A folder stands there, its folder is not there, or it is not ours to write.
    """
    folder = path.parent
    if path.is_dir():
        reason = "Is a directory; name a file in it"
    elif not folder.is_dir():
        reason = f"No such folder: {folder}; make it first"
    elif not os.access(path if path.exists() else folder, os.W_OK):
        reason = "Permission denied"
    else:
        return
    raise OptionError(f"{path}: cannot be written: {reason}")


def make_folder(path: Path) -> None:
    """Make a folder for output, with those above it.

    Raises:
        OptionError: It cannot be made or written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OptionError(f"{path}: cannot be made: {error.strerror or error}") from error
    if not os.access(path, os.W_OK):
        raise OptionError(f"{path}: cannot be written: Permission denied")


def say(text: str) -> None:
    """Tell the user something; results for programs go to stdout, all else here."""
    print(text, file=sys.stderr, flush=True)
