"""The folders that this system gives a user for what we keep, for their eyes alone.

Which avatars were seen tells who was met, and preferences tell where.
"""

import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from platformdirs import PlatformDirs

_NAME: Final = "pica-telepresence"
_TITLE: Final = "PiCA Telepresence"


def cache_folder(system: type[PlatformDirs] = PlatformDirs) -> Path:
    """The folder for avatars that can be fetched again."""
    return system(_NAME, appauthor=False).user_cache_path / "avatars"


def models_folder() -> Path:
    """The folder for networks of others that this user has fetched."""
    return PlatformDirs(_NAME, appauthor=False).user_data_path / "models"


def pictures_folder() -> Path:
    """The folder for pictures that this user takes of a call."""
    return PlatformDirs(_NAME, appauthor=False).user_pictures_path / _TITLE


def videos_folder() -> Path:
    """The folder for recordings that this user makes of a call."""
    return PlatformDirs(_NAME, appauthor=False).user_videos_path / _TITLE


def preferences_folder(system: type[PlatformDirs] = PlatformDirs) -> Path:
    """The folder for this user's preferences."""
    return system(_NAME, appauthor=False, roaming=True).user_config_path


def make_private(folder: Path) -> None:
    """Make a folder that its owner alone can look into, or make one that is there be so.

    Raises:
        OSError: The system says no.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with suppress(PermissionError):  # another user's folder: its content is still ours alone
        folder.chmod(0o700)


def open_to_others(paths: Iterable[Path] = ()) -> Iterator[Path]:
    """Find what other users of this machine can read and should not: our two folders of this user,
    and these files. Where files have no such modes (Windows), nothing is found."""
    if os.name != "posix":
        return
    for path in (cache_folder(), preferences_folder(), *paths):
        with suppress(OSError):  # not there, or not ours to ask about
            if path.stat().st_mode & 0o077:
                yield path
