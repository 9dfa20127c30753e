"""The page: modules for a browser, and what of the other packages it needs: shaders and avatars.

These are files of packages that every install has. They are found, not imported: a relay has none
of the libraries that those need.
"""

from importlib.util import find_spec
from pathlib import Path

__all__ = ["avatar_files", "shader_texts"]


def shader_texts() -> dict[str, str]:
    """The shaders that the page composes, by name."""
    return {
        file.name: file.read_text(encoding="utf-8")
        for file in _files("pica_client", "render/shaders/*.*")
    }


def avatar_files() -> list[Path]:
    """The avatars that ship."""
    return _files("pica_core", "avatars/*.pica")


def _files(package: str, pattern: str) -> list[Path]:
    found = find_spec(package)
    folders = [] if found is None else found.submodule_search_locations or []
    return sorted(file for folder in folders for file in Path(folder).glob(pattern))
