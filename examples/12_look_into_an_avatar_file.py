"""Look into an avatar file, change its name and write it again.

You learn what travels to those who see you: a manifest, and tensors of weights, maps and a mesh;
no code. The file is the avatar, and its SHA-256 is its name on the wire.
"""

import sys
from dataclasses import replace
from pathlib import Path

from pica_core.avatar.file import avatar_id, load_avatar, save_avatar, shipped_avatar_files

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
OUT.mkdir(parents=True, exist_ok=True)

file = shipped_avatar_files()[0]
avatar = load_avatar(file)  # everything in it is checked here, and trusted from now on
print(f"{avatar.manifest.name}, {avatar.manifest.licence}, {file.stat().st_size / 1e6:.2f} MB")
print(f"levels of detail: {avatar.levels} texels a side")
sizes: dict[str, int] = {}
for name, tensor in avatar.tensors.items():
    part = name.split(".")[0]
    sizes[part] = sizes.get(part, 0) + tensor.size
for part, size in sorted(sizes.items(), key=lambda item: -item[1]):
    print(f"{part:12} {size:9,d} numbers")

renamed = replace(avatar, manifest=replace(avatar.manifest, name="Renamed"))
copy = OUT / "renamed.pica"
save_avatar(copy, renamed)
print(f"{file.name} is {avatar_id(file)[:8]}, {copy.name} is {avatar_id(copy)[:8]}")
assert load_avatar(copy).manifest.name == "Renamed"
