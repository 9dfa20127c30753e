"""Folders that several processes share the work on: who works on which."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

MARK = "taken"


def take(folder: Path) -> bool:
    """Claim a folder, made if missing; False if a process that still lives has it."""
    folder.mkdir(parents=True, exist_ok=True)
    mark = folder / MARK
    with suppress(FileNotFoundError, ValueError, ProcessLookupError):
        os.kill(int(mark.read_text()), 0)
        return False
    mark.write_text(str(os.getpid()))
    return True


def give_back(folder: Path) -> None:
    """The work on a folder has ended."""
    (folder / MARK).unlink(missing_ok=True)
