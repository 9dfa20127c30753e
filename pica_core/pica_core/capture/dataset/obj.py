"""Read an OBJ file: ``v``, ``vt``, ``f``, ``usemtl``, and ``o``/``g`` where it names no materials.

Polygons become fans of triangles. Lines are told apart first and read when asked for, so that a
file that only repeats another's faces costs little. What cannot be read is a `CaptureError`.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pica_core.capture.dataset.files import read_bytes
from pica_core.errors import CaptureError
from pica_core.types import Float64Array, IntArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ObjFile:
    """An OBJ file by kind of line, some with their numbers."""

    path: Path
    vertices: list[bytes]
    texture: list[bytes]
    faces: list[tuple[int, bytes]]
    names: list[tuple[int, bytes, bytes]]
    """Line number, keyword and name of ``usemtl``, ``o`` and ``g``."""

    def positions(self) -> Float64Array:
        """Vertices. ``[V, 3]``."""
        return self._numbers(self.vertices, "vertex", 3)

    def uv(self) -> Float64Array:
        """Texture coordinates, v upwards. ``[T, 2]``."""
        return self._numbers(self.texture, "texture coordinate", 2)

    def _numbers(self, lines: list[bytes], kind: str, width: int) -> Float64Array:
        try:
            return np.array([line.split()[:width] for line in lines], np.float64).reshape(-1, width)
        except ValueError as error:
            what = f"a {kind} is not {width} numbers ({error})"
            raise CaptureError(f"{self.path}: {what}") from error

    def _corner(self, number: int, word: bytes) -> tuple[int, int]:
        """Position and texture index of ``7``, ``7/3``, ``7/3/1`` or ``7//1``; -1 is no texture."""
        parts = word.split(b"/")
        try:
            indices = [int(parts[0]), int(parts[1]) if len(parts) > 1 and parts[1] else 0]
        except ValueError:
            indices = [0, 0]
        for k, lines in enumerate((self.vertices, self.texture)):
            value, count = indices[k], len(lines)
            indices[k] = value - 1 if value >= 0 else count + value
            if not 0 <= indices[k] < count and (k == 0 or value != 0):
                raise CaptureError(
                    f"{self.path}:{number}: face corner {word[:40].decode('utf-8', 'replace')!r} "
                    f"points outside {count} {('vertices', 'texture coordinates')[k]}"
                )
        return indices[0], indices[1]

    def triangles(self) -> tuple[IntArray, IntArray, IntArray, tuple[str, ...]]:
        """Position faces, texture faces (-1 where none), material per face, material names."""
        present = {head for _, head, _ in self.names}
        keyword = next((head for head in (b"usemtl", b"g") if head in present), b"o")
        changes = [(number, name) for number, head, name in self.names if head == keyword]
        names: list[str] = []
        corners: list[tuple[tuple[int, int], ...]] = []
        material: list[int] = []
        at, current = 0, 0
        for number, rest in self.faces:
            while at < len(changes) and changes[at][0] < number:
                name = changes[at][1].decode("utf-8", "replace")
                if name not in names:
                    names.append(name)
                current = names.index(name)
                at += 1
            if not names:
                names.append("default")
            polygon = [self._corner(number, word) for word in rest.split()]
            if len(polygon) < 3:
                raise CaptureError(f"{self.path}:{number}: a face of {len(polygon)} corners")
            for k in range(1, len(polygon) - 1):
                corners.append((polygon[0], polygon[k], polygon[k + 1]))
                material.append(current)
        both = np.array(corners, np.int32).reshape(-1, 3, 2)
        return both[..., 0], both[..., 1], np.array(material, np.int32), tuple(names)


def read_obj(path: Path) -> ObjFile:
    """Tell the lines of an OBJ file apart."""
    found = ObjFile(path=path, vertices=[], texture=[], faces=[], names=[])
    for number, line in enumerate(read_bytes(path).splitlines(), start=1):
        head, _, rest = line.strip().partition(b" ")
        if head == b"v":
            found.vertices.append(rest)
        elif head == b"vt":
            found.texture.append(rest)
        elif head == b"f":
            found.faces.append((number, rest))
        elif head in (b"usemtl", b"o", b"g"):
            found.names.append((number, head, rest.strip()))
    return found
