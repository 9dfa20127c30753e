"""Read a Multiface directory as it was published: no `capture.json`, no topology, no expressions.

What a capture of ours states is found out here: topology from the first tracked OBJ, image size
from the first image, and a split that holds out whole segments. Audio is left alone. Nothing of the
dataset is part of this project; it has a licence of its own (CC BY-NC 4.0).

Layout source: the published description of the dataset (Wuu et al. 2022, arXiv 2207.11243).
"""

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pica_core.capture.dataset import files, multiface
from pica_core.errors import CaptureError
from pica_core.types import Float64Array, Int64Array

HELD_OUT_EVERY = 10
"""Segments, in the order of their names, of which the fifth is for testing."""


def is_published(root: Path) -> bool:
    """Whether a directory without `capture.json` looks like a published one."""
    return all((root / name).exists() for name in (multiface.KRT, "images", "tracked_mesh"))


def describe_published(root: Path) -> tuple[dict[str, Any], tuple[files.CaptureFrame, ...]]:
    """What `capture.json` and the tables would say."""
    path = root / multiface.FRAME_LIST
    names: dict[tuple[str, str], None] = {}
    for number, line in enumerate(multiface.read_text(path).splitlines(), start=1):
        if words := line.split():
            segment, name = words if len(words) == 2 else (line, "")
            files.check_frame_name(f"{path}:{number}", segment, name, names)
            names[segment, name] = None
    if not names:
        raise CaptureError(f"{path}: no frames")
    segments = sorted({segment for segment, _ in names})
    middle = min(HELD_OUT_EVERY // 2, len(segments) - 1)
    held_out = segments[middle::HELD_OUT_EVERY] if len(segments) > 1 else []
    frames = tuple(
        files.CaptureFrame(
            index=index,
            listed=index,
            segment=segment,
            name=name,
            split="test" if segment in held_out else "train",
        )
        for index, (segment, name) in enumerate(names)
    )
    width, height = _image_size(root)
    info = {
        "schema": multiface.SCHEMA,
        "source": "a directory in the layout of the Multiface dataset",
        "licence": "that of its publisher",
        "width": width,
        "height": height,
        "texture_size": _texture_size(root),
    }
    return info, frames


def _image_size(root: Path) -> tuple[int, int]:
    for path in (root / "images").glob("*/*/*.png"):
        try:
            height, width, _ = files.load_image(path, "RGB", None).shape
            return width, height
        except CaptureError:
            continue
    raise CaptureError(f"{root / 'images'}: no image to take the size of")


def _texture_size(root: Path) -> int:
    for path in sorted(root.glob("unwrapped_uv_*")):
        found = re.fullmatch(r"unwrapped_uv_(\d{1,4})", path.name)
        if found and int(found.group(1)) > 0:
            return int(found.group(1))
    raise CaptureError(f"{root}: no unwrapped_uv_SIZE directory")


class ObjMesh(NamedTuple):
    """The mesh of an OBJ file.

    Attributes:
        points: Vertices. ``[V, 3]``.
        uv: Texture coordinates, v upwards. ``[T, 2]``.
        faces: Vertex and texture coordinate of each triangle's corners. ``[F, 3, 2]``.
    """

    points: Float64Array
    uv: Float64Array
    faces: Int64Array


def read_obj(path: Path) -> ObjMesh:
    """Read ``v``, ``vt`` and ``f`` of an OBJ file; polygons become fans of triangles.

    Raises:
        CaptureError: A line that is cut, or a corner without a texture coordinate.

    Not checked: that corners lie within the vertices.
    """
    lines: dict[bytes, list[Any]] = {b"v": [], b"vt": [], b"f": []}
    for line in multiface.read_bytes(path).splitlines():
        head, _, rest = line.strip().partition(b" ")
        if head in lines:
            lines[head].append(rest.split())
    corners = []
    try:
        for polygon in lines[b"f"]:
            ends = [[int(number) - 1 for number in word.split(b"/")[:2]] for word in polygon]
            corners += [(ends[0], *ends[k : k + 2]) for k in range(1, len(ends) - 1)]
        return ObjMesh(
            np.array([words[:3] for words in lines[b"v"]], np.float64).reshape(-1, 3),
            np.array([words[:2] for words in lines[b"vt"]], np.float64).reshape(-1, 2),
            np.array(corners, np.int64).reshape(-1, 3, 2),
        )
    except ValueError as error:
        raise CaptureError(f"{path}: a line cannot be read ({error})") from error


def published_topology(
    root: Path, frames: tuple[files.CaptureFrame, ...]
) -> tuple[files.Topology, Int64Array, int]:
    """Topology of the first OBJ, the OBJ's vertex for each of its vertices, and how many it has."""
    for frame in frames:
        path = (root / multiface.mesh_path(frame.segment, frame.name)).with_suffix(".obj")
        if path.is_file():
            break
    else:
        where = root / "tracked_mesh"
        raise CaptureError(f"{where}: no OBJ of a listed frame to take the topology of")
    obj = read_obj(path)
    count, limits = len(obj.points), (len(obj.points), len(obj.uv))
    if not len(obj.faces) or (obj.faces < 0).any() or (obj.faces >= limits).any():
        raise CaptureError(
            f"{path}: triangles of {count} vertices and {len(obj.uv)} texture coordinates are "
            "needed"
        )
    pairs, faces = np.unique(obj.faces.reshape(-1, 2), axis=0, return_inverse=True)
    uv = obj.uv.astype(np.float32)[pairs[:, 1]]
    if not np.isfinite(uv).all():
        raise CaptureError(f"{path}: a texture coordinate is not finite")
    topology = files.Topology(vertex_uv=uv, faces=faces.reshape(-1, 3).astype(np.int32), regions={})
    return topology, np.ascontiguousarray(pairs[:, 0]), count
