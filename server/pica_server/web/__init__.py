"""The page: modules for a browser, and the shaders that they draw with."""

from importlib.util import find_spec
from pathlib import Path

__all__ = ["shader_texts"]


def shader_texts() -> dict[str, str]:
    """The shaders that the page composes, by name: files of the client's package, which every
    install has; it is found, not imported, for a relay has none of what the client needs."""
    found = find_spec("pica_client")
    folder = Path(next(iter(found.submodule_search_locations or ()))) if found else Path()
    files = (folder / "render" / "shaders").glob("*.*")
    return {file.name: file.read_text(encoding="utf-8") for file in sorted(files)}
