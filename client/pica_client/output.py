"""Files that a command writes: refused at its start where that can be known, and with one wording
where it comes out later."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pica_client.errors import OptionError
from pica_core.files import replacing
from pica_protocol.limits import printable


@contextmanager
def writing_whole(path: Path) -> Iterator[Path]:
    """Give a new file to write to, which becomes `path` at the end of the block, or nothing does.

    Raises:
        OptionError: The block met an `OSError`.
    """
    with writing(path), replacing(path) as unfinished:
        yield unfinished


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


class Outputs:
    """What a command was asked to write; what cannot be costs neither its work nor its report.

    Attributes:
        failures: A line for each file that could not be written.
    """

    def __init__(self) -> None:
        self.failures: list[str] = []

    def attempt(self, write: Callable[[], object]) -> bool:
        """Write something; return whether that was possible."""
        try:
            write()
        except OptionError as error:
            self.fail(str(error))
            return False
        return True

    def fail(self, failure: str) -> None:
        """Tell and note why something could not be written."""
        self.failures.append(failure)
        say(failure)


def check_writable(path: Path | None, suffix: str = "") -> None:
    """Refuse before the work what could not be written after it. Writes nothing.

    Args:
        path: The file; None: there will be none.
        suffix: What the name of such a file ends in; a name without any ending will do, too.

    Raises:
        OptionError: A folder stands there, its folder is not there, it is not ours to write, or its
            name promises another kind of file.
    """
    if path is None:
        return
    if suffix and path.suffix.lower() not in ("", suffix):
        better = path.with_suffix(suffix)
        raise OptionError(f"{path}: would hold {suffix[1:].upper()} all the same; name it {better}")
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
    print(printable(text), file=sys.stderr, flush=True)
