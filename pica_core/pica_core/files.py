"""A user's folders, files that are written whole or not at all, and tables that ship."""

import json
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import resources
from pathlib import Path
from typing import Any

from platformdirs import PlatformDirs

FOLDERS = PlatformDirs("pica-telepresence", appauthor=False, roaming=True)
"""This user's folders for what is fetched, set, made and recorded."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a new file beside `path` to write to, which takes its place when the block has ended.

    When the block fails, as on a full disk, what stood at `path` before still does, and nothing is
    left beside it. What is no ordinary file, such as a device, is written to itself.

    Raises:
        OSError: The file cannot take its place.
    """
    path = path.resolve()
    if path.exists() and not path.is_file():
        yield path
        return
    unfinished = path.with_name(f".{path.name[:64]}-{secrets.token_hex(8)}.part")
    try:
        yield unfinished
        os.replace(unfinished, path)
    finally:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)


def packaged_json(package: str, name: str) -> Any:
    """What a JSON file holds that ships in a package."""
    return json.loads((resources.files(package) / name).read_text("utf-8"))
