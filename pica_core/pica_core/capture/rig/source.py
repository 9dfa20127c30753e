"""A rig as its file has it: one mesh, its UVs and materials, and what each shape adds.

Readers of glTF (`gltf`) and of OBJ folders fill it; nothing later depends on the file's format.
Checks of what the numbers say stand here, so that both readers refuse the same things in the same
words: every problem is a `CaptureError` that names the file.
"""

import io
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from PIL import Image

from pica_core.capture.dataset.files import IMAGE_FORMATS
from pica_core.capture.dataset.obj import read_obj
from pica_core.errors import CaptureError
from pica_core.types import BoolArray, ByteArray, Float64Array, FloatArray, IntArray

MAX_VERTICES = 500_000
MAX_FACES = 1_000_000
MAX_SHAPES = 1_000
MAX_SHAPE_VALUES = 30_000_000
"""Vertices times shapes, at most: 360 MB as float32 triples (detailed rigs have 20 million)."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RigImage:
    """An encoded base colour image, and how it goes on beyond its edges, across and down."""

    data: bytes
    wrap: tuple[str, str] = ("repeat", "repeat")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RigSource:
    """A head with blendshapes, in the units and axes of its file.

    Attributes:
        positions: Vertices of the neutral face. float64 ``[V, 3]``.
        faces: Triangles as indices into `positions`. int32 ``[F, 3]``.
        uv: Texture coordinates with v downwards, or None. Beyond [0, 1] images go on as their
            `wrap` says. float64 ``[T, 2]``.
        uv_faces: The same triangles as indices into `uv`, or None. int32 ``[F, 3]``.
        face_material: Index into `materials`. int32 ``[F]``.
        shapes: What each shape adds to `positions` at a value of 1. float32 ``[V, 3]`` each.
        split_at_seams: True when vertices are there twice where texture coordinates part.
        copyright: What the file says of its rights.
        images: Base colour image of a material, where the file has one.
        see_through: Triangles that hide nothing, such as lenses; None: all hide. bool ``[F]``.
    """

    path: Path
    positions: Float64Array
    faces: IntArray
    uv: Float64Array | None
    uv_faces: IntArray | None
    materials: tuple[str, ...]
    face_material: IntArray
    shapes: dict[str, FloatArray]
    split_at_seams: bool = False
    copyright: str = ""
    images: dict[int, RigImage] = field(default_factory=dict)
    see_through: BoolArray | None = None


def check_counts(where: str, *, vertices: int, faces: int, shapes: int) -> None:
    """Refuse hostile sizes before anything is allocated."""
    for name, value, limit in (
        ("vertices", vertices, MAX_VERTICES),
        ("faces", faces, MAX_FACES),
        ("shapes", shapes, MAX_SHAPES),
        ("vertices times shapes", vertices * shapes, MAX_SHAPE_VALUES),
    ):
        if value > limit:
            raise CaptureError(f"{where}: {value} {name}; at most {limit} are allowed")
    if vertices == 0 or faces == 0:
        raise CaptureError(f"{where}: {vertices} vertices and {faces} faces; a mesh is needed")


def check_source(source: RigSource) -> RigSource:
    """Validate what a reader found, its indices apart, and leave out triangles without area."""
    where, vertices = source.path, len(source.positions)
    check_counts(str(where), vertices=vertices, faces=len(source.faces), shapes=len(source.shapes))
    if not source.shapes:
        raise CaptureError(f"{where}: no blendshapes; a rig needs shapes such as jawOpen")
    bad = np.flatnonzero(~np.isfinite(source.positions).all(1))
    if bad.size:
        raise CaptureError(f"{where}: vertex {bad[0]} of the neutral face is not finite")
    for name, delta in source.shapes.items():
        if not np.isfinite(delta).all():
            row = int(np.flatnonzero(~np.isfinite(delta).all(1))[0])
            raise CaptureError(f"{where}: vertex {row} of shape {name!r} is not finite")
    keep = (source.faces != np.roll(source.faces, 1, axis=1)).all(1)
    uv_faces = source.uv_faces
    if source.uv is not None and uv_faces is not None:
        if not np.isfinite(source.uv).all():
            raise CaptureError(f"{where}: texture coordinates are not all finite")
        if (far := np.abs(source.uv).max()) > 100:
            raise CaptureError(
                f"{where}: texture coordinates reach {far:.3g}; tiles up to 100 are allowed"
            )
        uv_faces = uv_faces[keep]
    return replace(
        source,
        faces=source.faces[keep],
        uv_faces=uv_faces,
        face_material=source.face_material[keep],
        see_through=source.see_through[keep] if source.see_through is not None else None,
    )


MAX_ALBEDO_SIDE = 8192
ALBEDO_MODES = ("RGB", "RGBA", "L", "LA", "P", "PA")


def open_image(where: str, data: bytes) -> ByteArray:
    """A PNG, JPEG or WebP image as sRGB with alpha, row 0 on top. uint8 ``[H, W, 4]``."""
    try:
        with Image.open(io.BytesIO(data), formats=IMAGE_FORMATS) as image:
            if max(image.size) > MAX_ALBEDO_SIDE:
                raise CaptureError(
                    f"{where}: {image.width}x{image.height} pixels; sides up to {MAX_ALBEDO_SIDE} "
                    "are allowed"
                )
            if image.mode not in ALBEDO_MODES:
                raise CaptureError(
                    f"{where}: pixels are {image.mode}; an 8-bit colour image is needed"
                )
            return np.asarray(image.convert("RGBA"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise CaptureError(f"{where}: not a complete image ({error})") from error


def wrapped(uv: Float64Array, wrap: tuple[str, str]) -> Float64Array:
    """Texture coordinates brought into [0, 1] as a sampler does. ``[..., 2]``."""
    rules = {
        "repeat": lambda t: t - np.floor(t),
        "mirror": lambda t: 1 - np.abs(np.mod(t, 2) - 1),
        "clamp": lambda t: np.clip(t, 0, 1),
    }
    return np.stack([rules[how](uv[..., axis]) for axis, how in enumerate(wrap)], -1)


def see_through(
    alpha: Float64Array, cutoff: float, corners: Float64Array, wrap: tuple[str, str]
) -> BoolArray:
    """Triangles of which less than half is as opaque as `cutoff`.

    Args:
        alpha: Opacity 0 to 1, row 0 on top. ``[H, W]``.
        cutoff: Opacity from which on a point is taken for solid.
        corners: Texture coordinates of each triangle, v downwards. ``[F, 3, 2]``.
        wrap: How the image goes on beyond its edges, across and down.
    """
    steps = (np.arange(6) + 0.5) / 6
    a, b = np.meshgrid(steps, steps)
    weights = np.stack([a, b, 1 - a - b], -1)[a + b < 1]
    uv = wrapped(np.einsum("sk,fkc->fsc", weights, corners), wrap)
    height, width = alpha.shape
    column = np.minimum(uv[..., 0] * width, width - 1).astype(np.int64)
    row = np.minimum(uv[..., 1] * height, height - 1).astype(np.int64)
    clear: BoolArray = (alpha[row, column] >= cutoff).mean(1) < 0.5
    return clear


NEUTRAL_WORDS = ("neutral", "basis", "rest", "base")
"""What the name of the neutral face's file contains, the first that is found."""


def read_obj_folder(folder: Path) -> RigSource:
    """Read a rig: one neutral OBJ (neutral, basis, rest or base in its name), and one per shape."""
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
    neutral = read_obj(neutral_path)
    check_counts(
        str(neutral_path),
        vertices=len(neutral.vertices),
        faces=len(neutral.faces),
        shapes=len(paths) - 1,
    )
    positions = neutral.positions()
    faces, uv_faces, material, names = neutral.triangles()
    uv = None
    if neutral.texture and (uv_faces >= 0).all():
        uv = neutral.uv()
        uv[:, 1] = 1 - uv[:, 1]
    face_text = [rest.split() for _, rest in neutral.faces]
    shapes: dict[str, FloatArray] = {}
    for path in paths:
        if path == neutral_path:
            continue
        shape = read_obj(path)
        if len(shape.vertices) != len(positions):
            raise CaptureError(
                f"{path}: {len(shape.vertices)} vertices; {neutral_path.name} has "
                f"{len(positions)}, and all OBJ files must share one topology"
            )
        if [rest.split() for _, rest in shape.faces] != face_text:
            other = shape.triangles()[0]
            if other.shape != faces.shape or (other != faces).any():
                raise CaptureError(
                    f"{path}: its faces differ from those of {neutral_path.name}; all OBJ files "
                    "must share one topology"
                )
        posed = shape.positions()
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
