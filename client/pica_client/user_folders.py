"""The folders that this system gives a user for what we keep."""

import sys
from pathlib import Path
from typing import Final

from platformdirs import PlatformDirs

_NAME: Final = "pica-telepresence"


def cache_folder(system: type[PlatformDirs] = PlatformDirs) -> Path:
    """The folder for avatars that can be fetched again."""
    return system(_NAME, appauthor=False).user_cache_path / "avatars"


def preferences_folder(system: type[PlatformDirs] = PlatformDirs) -> Path:
    """The folder for this user's preferences."""
    # On macOS we once did not look at XDG_CONFIG_HOME; what was kept then is still found.
    former = Path.home() / "Library" / "Application Support" / _NAME
    if sys.platform == "darwin" and former.is_dir():
        return former
    return system(_NAME, appauthor=False, roaming=True).user_config_path
