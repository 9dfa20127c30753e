"""The avatars inside the package, and files by their names; needs no numpy."""

import os
from importlib import resources
from pathlib import Path
from typing import Final

from pica_core.errors import AvatarFileError

SUFFIX: Final = ".pica"


def shipped_avatar_files() -> list[Path]:
    """The avatar files inside the package, by name."""
    folder = resources.files("pica_core") / "avatars"
    if not folder.is_dir():
        return []
    return sorted(Path(str(item)) for item in folder.iterdir() if item.name.endswith(SUFFIX))


def shipped_portraits() -> dict[str, Path]:
    """The PNG files that show the shipped avatars at rest, by the avatars' names."""
    pictures = {file.stem: file.with_suffix(".png") for file in shipped_avatar_files()}
    return {name: picture for name, picture in pictures.items() if picture.is_file()}


def avatar_file(named: Path) -> Path:
    """The file that a name means: itself, or that of an avatar that ships.

    Raises:
        AvatarFileError: It is neither a file's name nor that of a shipped avatar.
    """
    if named.suffix == SUFFIX or named.is_file():
        return Path(os.path.expanduser(named))
    shipped = {path.stem: path for path in shipped_avatar_files()}
    if (name := str(named).lower()) not in shipped:
        known = ", ".join(shipped) or "none"
        raise AvatarFileError(
            f"avatar {str(named)!r} is unknown; shipped are: {known}; or give a {SUFFIX} file"
        )
    return shipped[name]
