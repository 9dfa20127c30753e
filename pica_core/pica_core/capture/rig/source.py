"""A rig as its file has it: one mesh, its UVs and materials, and what each shape adds.

Checks of what the numbers say stand here: every problem is a `CaptureError` that names the file.
"""

import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates

from pica_core.capture.dataset.files import IMAGE_FORMATS
from pica_core.errors import CaptureError
from pica_core.types import ByteArray, Float64Array, FloatArray, IntArray

MAX_VERTICES = 500_000
MAX_FACES = 1_000_000
MAX_SHAPES = 1_000
MAX_SHAPE_VALUES = 30_000_000
"""Vertices times shapes, at most: 360 MB as float32 triples (detailed rigs have 20 million)."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RigSource:
    """A head with blendshapes, in the units of its file, +y up.

    Attributes:
        positions: Vertices of the neutral face, there twice where texture coordinates part.
            float64 ``[V, 3]``.
        faces: Triangles as indices into `positions`. int32 ``[F, 3]``.
        uv: Texture coordinates with v downwards, 0 where there are none. Beyond [0, 1] images
            repeat. float64 ``[V, 2]``.
        face_material: Index into `materials`. int32 ``[F]``.
        shapes: What each shape adds to `positions` at a value of 1. float32 ``[V, 3]`` each.
        copyright: What the file says of its rights.
        images: Base colour image of a material, where the file has one: sRGB with alpha, row 0 on
            top. uint8 ``[H, W, 4]``.
        colours: Linear RGB that images are multiplied with. float32 ``[V, 3]``.
    """

    path: Path
    positions: Float64Array
    faces: IntArray
    uv: Float64Array
    materials: tuple[str, ...]
    face_material: IntArray
    shapes: dict[str, FloatArray]
    copyright: str
    images: dict[int, ByteArray]
    colours: FloatArray


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
    if not np.isfinite(source.uv).all():
        raise CaptureError(f"{where}: texture coordinates are not all finite")
    if (far := np.abs(source.uv).max()) > 100:
        raise CaptureError(
            f"{where}: texture coordinates reach {far:.3g}; tiles up to 100 are allowed"
        )
    keep = (source.faces != np.roll(source.faces, 1, axis=1)).all(1)
    return replace(
        source,
        faces=source.faces[keep],
        face_material=source.face_material[keep],
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


def opacity_at(image: ByteArray, uv: Float64Array) -> Float64Array:
    """Opacity 0 to 1 of an image at texture coordinates ``[..., 2]``, linear between pixels."""
    opacity = image[..., 3]
    height, width = opacity.shape
    column, row = np.moveaxis(np.mod(uv, 1.0), -1, 0)
    at = [row * height - 0.5, column * width - 0.5]
    found: Float64Array = map_coordinates(opacity, at, np.float64, order=1, mode="nearest")
    return found / 255
