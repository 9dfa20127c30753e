"""Folders that several processes share the work on: who works on which."""

from __future__ import annotations

import fcntl
from pathlib import Path
from typing import IO

MARK = "taken"

_held: dict[Path, IO[str]] = {}


def take(folder: Path) -> bool:
    """Claim a folder, made if missing; False if another process has it.

    A process that ends, however it does, gives back what it has.
    """
    folder.mkdir(parents=True, exist_ok=True)
    mark = (folder / MARK).open("w")
    try:
        fcntl.flock(mark, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        mark.close()
        return False
    _held[folder] = mark
    return True


def give_back(folder: Path) -> None:
    """The work on a folder has ended."""
    _held.pop(folder).close()
