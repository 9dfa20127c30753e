"""The page: modules for a browser, and what of the other packages it needs: shaders and avatars.

These are files of packages that every install has. They are found, not imported: a relay has none
of the libraries that those need.
"""

import ast
import base64
import hashlib
import zipfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

__all__ = ["avatar_files", "avatar_names", "mouth_weights", "shader_texts"]


def shader_texts() -> dict[str, str]:
    """The shaders that the page composes, by name."""
    return {
        file.name: file.read_text(encoding="utf-8")
        for file in _files("pica_client", "render/shaders/*.*")
    }


def avatar_files() -> list[Path]:
    """The avatars that ship."""
    return _files("pica_core", "avatars/*.pica")


def mouth_weights() -> dict[str, dict[str, Any]]:
    """The network that moves a mouth by a voice: by name the shape of a matrix, and its columns one
    after the other as half floats in base64."""
    found = {}
    for path in _files("pica_client", "voice/mouth.npz"):
        with zipfile.ZipFile(path) as file:
            for name in file.namelist():
                # The format of numpy: ten bytes, of which two are the length of the header.
                data = file.read(name)
                begin = 10 + int.from_bytes(data[8:10], "little")
                header = ast.literal_eval(data[10:begin].decode())
                halfs = base64.b64encode(data[begin:]).decode()
                found[Path(name).stem] = {"shape": header["shape"], "halfs": halfs}
    return found


def avatar_names() -> dict[str, str]:
    """The ids of the avatars that ship, by name."""
    return {
        path.stem.capitalize(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in avatar_files()
    }


def _files(package: str, pattern: str) -> list[Path]:
    found = find_spec(package)
    folders = [] if found is None else found.submodule_search_locations or []
    return sorted(file for folder in folders for file in Path(folder).glob(pattern))
