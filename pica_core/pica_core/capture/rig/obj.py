"""Read a rig from a folder of OBJ files: a neutral face and one file per shape, one topology.

Only what a head needs is read: ``v``, ``vt``, ``f``, ``usemtl``, and ``o``/``g`` where a file names
no materials. Polygons become fans of triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pica_core.capture.rig.source import RigSource, check_counts, check_source, read_bytes
from pica_core.errors import CaptureError
from pica_core.types import Float64Array, FloatArray, IntArray

NEUTRAL_WORDS = ("neutral", "basis", "rest", "base")
"""What the name of the neutral face's file contains, the first that is found."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Lines:
    """An OBJ file by kind of line, each with its number."""

    path: Path
    vertices: list[bytes]
    texture: list[bytes]
    faces: list[tuple[int, bytes]]
    names: list[tuple[int, bytes, bytes]]
    """Line number, keyword and name of ``usemtl``, ``o`` and ``g``."""


def _split(path: Path) -> _Lines:
    found = _Lines(path=path, vertices=[], texture=[], faces=[], names=[])
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


def _numbers(path: Path, lines: list[bytes], kind: str, width: int) -> Float64Array:
    try:
        return np.array([line.split()[:width] for line in lines], np.float64).reshape(-1, width)
    except ValueError:
        for index, line in enumerate(lines):
            try:
                good = len(np.array(line.split()[:width], np.float64)) == width
            except ValueError:
                good = False
            if not good:
                raise CaptureError(
                    f"{path}: {kind} {index + 1} is {line[:60].decode('utf-8', 'replace')!r}; "
                    f"{width} numbers are needed"
                ) from None
        raise


def _corner(path: Path, number: int, word: bytes, counts: tuple[int, int]) -> tuple[int, int]:
    """Position and texture index of ``7``, ``7/3``, ``7/3/1`` or ``7//1``; -1 for no texture."""
    parts = word.split(b"/")
    try:
        indices = [int(parts[0]), int(parts[1]) if len(parts) > 1 and parts[1] else 0]
    except ValueError:
        indices = [0, 0]
    for k, (value, count) in enumerate(zip(indices, counts, strict=True)):
        indices[k] = value - 1 if value >= 0 else count + value
        outside = indices[k] < 0 or indices[k] >= count
        if outside and (k == 0 or value != 0):
            raise CaptureError(
                f"{path}:{number}: face corner {word[:40].decode('utf-8', 'replace')!r} points "
                f"outside {count} {('vertices', 'texture coordinates')[k]}"
            )
    return indices[0], indices[1]


def _triangles(lines: _Lines) -> tuple[IntArray, IntArray, IntArray, tuple[str, ...]]:
    """Position faces, texture faces (-1 where none), material per face, material names."""
    counts = len(lines.vertices), len(lines.texture)
    keyword = b"usemtl" if any(head == b"usemtl" for _, head, _ in lines.names) else b"g"
    if not any(head == keyword for _, head, _ in lines.names):
        keyword = b"o"
    changes = [(number, name) for number, head, name in lines.names if head == keyword]
    names: list[str] = []
    corners: list[tuple[tuple[int, int], ...]] = []
    material: list[int] = []
    at, current = 0, 0
    for number, rest in lines.faces:
        while at < len(changes) and changes[at][0] < number:
            name = changes[at][1].decode("utf-8", "replace")
            if name not in names:
                names.append(name)
            current = names.index(name)
            at += 1
        if not names:
            names.append("default")
        polygon = [_corner(lines.path, number, word, counts) for word in rest.split()]
        if len(polygon) < 3:
            raise CaptureError(f"{lines.path}:{number}: a face of {len(polygon)} corners")
        for k in range(1, len(polygon) - 1):
            corners.append((polygon[0], polygon[k], polygon[k + 1]))
            material.append(current)
    both = np.array(corners, np.int32).reshape(-1, 3, 2)
    return both[..., 0], both[..., 1], np.array(material, np.int32), tuple(names)


def read_obj_folder(folder: Path) -> RigSource:
    """Read a rig: one neutral OBJ (neutral, basis, rest or base in its name), and one per shape.

    Raises:
        CaptureError: No neutral face, no shapes, different topologies, or bad numbers.
    """
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() == ".obj")
    if not paths:
        raise CaptureError(f"{folder}: no OBJ files")
    neutral_path = next(
        (p for word in NEUTRAL_WORDS for p in paths if word in p.stem.lower()), None
    )
    if neutral_path is None:
        raise CaptureError(
            f"{folder}: which of {len(paths)} OBJ files is the neutral face? "
            f"Its name must contain one of {', '.join(NEUTRAL_WORDS)}"
        )
    neutral = _split(neutral_path)
    check_counts(
        str(neutral_path),
        vertices=len(neutral.vertices),
        faces=len(neutral.faces),
        shapes=len(paths) - 1,
    )
    positions = _numbers(neutral_path, neutral.vertices, "vertex", 3)
    faces, uv_faces, material, names = _triangles(neutral)
    uv = None
    if neutral.texture and (uv_faces >= 0).all():
        uv = _numbers(neutral_path, neutral.texture, "texture coordinate", 2)
        uv[:, 1] = 1 - uv[:, 1]
    face_text = [rest.split() for _, rest in neutral.faces]
    shapes: dict[str, FloatArray] = {}
    for path in paths:
        if path == neutral_path:
            continue
        lines = _split(path)
        if len(lines.vertices) != len(positions):
            raise CaptureError(
                f"{path}: {len(lines.vertices)} vertices; {neutral_path.name} has "
                f"{len(positions)}, and all OBJ files must share one topology"
            )
        same = [rest.split() for _, rest in lines.faces] == face_text
        if not same:
            other = _triangles(lines)[0]
            if other.shape != faces.shape or (other != faces).any():
                raise CaptureError(
                    f"{path}: its faces differ from those of {neutral_path.name}; all OBJ files "
                    "must share one topology"
                )
        posed = _numbers(path, lines.vertices, "vertex", 3)
        if not np.isfinite(posed).all():
            row = int(np.flatnonzero(~np.isfinite(posed).all(1))[0])
            raise CaptureError(f"{path}: vertex {row + 1} is not finite")
        shapes[path.stem] = (posed - positions).astype(np.float32)
    return check_source(
        RigSource(
            path=folder,
            positions=positions,
            faces=faces,
            uv=uv,
            uv_faces=uv_faces if uv is not None else None,
            materials=names,
            face_material=material,
            shapes=shapes,
        )
    )
