"""A rig as its file has it: one mesh, its UVs and materials, and what each shape adds.

Readers (`gltf`, `obj`) fill it; everything after them is independent of the file's format.
Checks of what the numbers say stand here, so that both readers refuse the same things in the same
words: every problem is a `CaptureError` that names the file.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pica_core.errors import CaptureError
from pica_core.types import BoolArray, Float64Array, FloatArray, IntArray

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
