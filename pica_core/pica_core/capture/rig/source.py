"""A rig as its file has it: one mesh, its UVs and materials, and what each shape adds.

A glTF 2.0 file (.glb, .vrm, or .gltf with files beside it) is read as bytes and numbers here.

Checks of what the numbers say stand here: every problem is a `CaptureError` that names the file.

glTF is read without a library, since none that we found reads morph targets and checks what it
reads (trimesh drops them, pygltflib gives the JSON document and little more). A rig may come from a
stranger: sizes are limited before anything is allocated, and numpy checks that arrays lie in their
buffers. An entry that is missing or of another kind is the `KeyError`, `TypeError` ... of its use,
which `gltf.read_rig` turns into a `CaptureError`.

    buffers -> views -> accessors (sparse, normalised)
"""

import base64
import io
import json
import math
import struct
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates

from pica_core.capture.dataset.files import IMAGE_FORMATS
from pica_core.capture.dataset.multiface import MAX_FILE_BYTES, read_bytes
from pica_core.errors import CaptureError
from pica_core.types import Array, ByteArray, Float64Array, FloatArray, IntArray

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
        smaller_images: Those that were read smaller than they are stored, one line each.
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
    smaller_images: tuple[str, ...]


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


MAX_IMAGE_PIXELS = 8192 * 8192
"""Of all images of a rig together, 256 MB."""


def open_image(
    where: str, data: bytes, max_pixels: int = MAX_IMAGE_PIXELS, told: list[str] | None = None
) -> ByteArray:
    """A PNG, JPEG or WebP image as sRGB with alpha, row 0 on top; a larger one than `max_pixels`
    as a half, a third ... of its size, as `told` says then. uint8 ``[H, W, 4]``."""
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
            part = math.ceil(math.sqrt(image.width * image.height / max_pixels))
            size = (max(image.width // part, 1), max(image.height // part, 1))
            if part > 1 and told is not None:
                told.append(f"{image.width}x{image.height} pixels as {size[0]}x{size[1]}")
            filters = Image.Resampling  # but for RGB, mixing pixels takes several copies
            how = filters.BOX if image.mode == "RGB" else filters.NEAREST
            return np.asarray((image.resize(size, how) if part > 1 else image).convert("RGBA"))
    except Image.DecompressionBombError as error:
        allowed = f"sides up to {MAX_ALBEDO_SIDE} are allowed"
        raise CaptureError(f"{where}: {error}; {allowed}") from error
    except (OSError, SyntaxError, ValueError) as error:
        raise CaptureError(f"{where}: not a complete image ({error})") from error


def opacity_at(image: ByteArray, uv: Float64Array) -> Float64Array:
    """Opacity 0 to 1 of an image at texture coordinates ``[..., 2]``, linear between pixels."""
    opacity = image[..., 3]
    height, width = opacity.shape
    column, row = np.moveaxis(np.mod(uv, 1.0), -1, 0)
    at = [row * height - 0.5, column * width - 0.5]
    found: Float64Array = map_coordinates(opacity, at, np.float64, order=1, mode="nearest")
    return found / 255


MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
COMPONENT = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
MAX_ELEMENTS = 1_000_000
MAX_JSON_VALUES = 1_000_000
"""Of a document (chosen: rigs have thousands, and a million takes 250 MB)."""
UNDERSTOOD = ("KHR_mesh_quantization", "KHR_texture_transform", "EXT_texture_webp", "VRM")
"""Required extensions that are read; those that say how light meets a surface change nothing."""
HARMLESS = ("KHR_materials_", "VRMC_")


def extension(owner: dict[str, Any], name: str) -> dict[str, Any]:
    """The content of an extension that an entry has, or nothing."""
    found: dict[str, Any] = owner.get("extensions", {}).get(name, {})
    return found


def count_of(owner: dict[str, Any], name: str, default: int | None = None) -> int:
    """A count, offset or index that is not negative."""
    value = owner.get(name, default)
    if not isinstance(value, int) or value < 0:
        raise ValueError(f"field {name!r} is {value!r}; 0 or more is needed")
    return value


class GltfFile:
    """One file and what lies beside it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        data = read_bytes(path)
        self._binary: bytes | None = None
        text = data if path.suffix.lower() == ".gltf" and data[:4] != b"glTF" else self._glb(data)
        if (values := text.count(b",")) > MAX_JSON_VALUES:
            allowed = f"at most {MAX_JSON_VALUES:,} are allowed"
            raise CaptureError(f"{path}: the JSON document has {values:,} values; {allowed}")
        try:
            self.root = json.loads(text.decode("utf-8-sig").rstrip("\0 "))
        except (ValueError, RecursionError) as error:
            raise CaptureError(f"{path}: the JSON document cannot be read ({error})") from error
        for name in self.root.get("extensionsRequired", []):
            if name not in UNDERSTOOD and not name.startswith(HARMLESS):
                raise CaptureError(
                    f"{path}: needs the extension {name!r}, which is not read here; "
                    "export without it"
                )
        self.buffer = cache(self._buffer)
        self.image = cache(self._image)
        self._pixels_left = MAX_IMAGE_PIXELS
        self.smaller_images: list[str] = []
        self._beside = cache(read_bytes)
        self._beside_bytes = 0

    def _glb(self, data: bytes) -> bytes:
        """The JSON document of a binary file, whose buffer is kept."""
        magic, version, length = struct.unpack_from("<III", data)
        if magic != MAGIC or version != 2:
            raise CaptureError(f"{self.path}: not a glTF 2.0 file (.glb, .vrm or .gltf)")
        if length > len(data):
            raise CaptureError(f"{self.path}: {len(data)} bytes; its header says {length}")
        chunks: dict[int, bytes] = {}
        at = 12
        while at + 8 <= length:
            size, kind = struct.unpack_from("<II", data, at)
            if size > length - at - 8:
                raise CaptureError(f"{self.path}: a chunk of {size} bytes does not fit into it")
            chunks.setdefault(kind, data[at + 8 : at + 8 + size])
            at += 8 + size
        self._binary = chunks.get(BINARY_CHUNK, b"")
        return chunks[JSON_CHUNK]

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """One entry of a top-level list such as ``accessors``."""
        entries = self.root.get(kind, [])
        if not isinstance(index, int) or not 0 <= index < len(entries):
            raise CaptureError(f"{self.path}: {kind} {index!r} does not exist")
        entry: dict[str, Any] = entries[index]
        return entry

    def resource(self, uri: str) -> bytes:
        """What a URI names: data in the document, or a file in the folder of this one."""
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(";base64,")[2], validate=True)
        name, folder = unquote(uri), self.path.parent.resolve()
        if "://" in name or "\0" in name or "\\" in name:
            raise CaptureError(f"{self.path}: {uri[:200]!r} is no file beside it")
        place = (folder / name).resolve()
        if not place.is_relative_to(folder):
            raise CaptureError(f"{self.path}: {uri[:200]!r} leaves the folder of the rig")
        data = self._beside(place)
        self._beside_bytes += len(data)
        if self._beside_bytes > MAX_FILE_BYTES:
            raise CaptureError(
                f"{self.path}: files beside it have more than {MAX_FILE_BYTES} bytes"
            )
        return data

    def _buffer(self, index: int) -> bytes:
        entry = self.item("buffers", index)
        if "uri" in entry:
            return self.resource(entry["uri"])
        if index or self._binary is None:
            raise CaptureError(f"{self.path}: buffers {index} has no data")
        return self._binary

    def _image(self, index: int) -> ByteArray:
        """An image, of at most half of the pixels that are left for it and for all others."""
        entry = self.item("images", index)
        data = self.resource(entry["uri"]) if "uri" in entry else None
        if data is None:
            data = bytes(self.view(count_of(entry, "bufferView"))[0])
        half = max(self._pixels_left // 2, 1)
        image = open_image(f"{self.path}: image {index}", data, half, self.smaller_images)
        self._pixels_left -= image.shape[0] * image.shape[1]
        return image

    def view(self, index: int) -> tuple[memoryview, int]:
        """Content and stride of a buffer view; stride 0: one element after the other."""
        view = self.item("bufferViews", index)
        data = self.buffer(view["buffer"])
        start = count_of(view, "byteOffset", 0)
        end = start + count_of(view, "byteLength")
        if end > len(data):
            raise CaptureError(
                f"{self.path}: bufferViews {index} ends at byte {end} of {len(data)}"
            )
        return memoryview(data)[start:end], count_of(view, "byteStride", 0)

    def elements(self, index: int, offset: int, dtype: str, count: int, width: int) -> Array:
        """Numbers of a buffer view as they are stored. ``[count, width]``."""
        data, stride = self.view(index)
        item = np.dtype(dtype).itemsize
        return np.ndarray((count, width), dtype, data, offset, (stride or item * width, item))

    def accessor(self, index: Any, width: int, limit: int = MAX_ELEMENTS) -> Array:
        """An accessor's numbers, ``[count, width]``; integers that are normalised become floats."""
        entry = self.item("accessors", index)
        dtype, count = COMPONENT[entry["componentType"]], count_of(entry, "count")
        if WIDTH.get(entry["type"]) != width:
            raise CaptureError(
                f"{self.path}: accessors {index} is {entry['type']!r}; {width} numbers per element "
                "are needed"
            )
        if not 0 < count <= limit:
            raise CaptureError(
                f"{self.path}: accessors {index} has {count} elements; 1 to {limit} are allowed"
            )
        if "bufferView" in entry:
            offset = count_of(entry, "byteOffset", 0)
            values = self.elements(entry["bufferView"], offset, dtype, count, width).copy()
        else:
            values = np.zeros((count, width), dtype)
        if "sparse" in entry:
            sparse = entry["sparse"]
            few, places, numbers = count_of(sparse, "count"), sparse["indices"], sparse["values"]
            kind, offset = COMPONENT[places["componentType"]], count_of(places, "byteOffset", 0)
            at = self.elements(places["bufferView"], offset, kind, few, 1)[:, 0]
            offset = count_of(numbers, "byteOffset", 0)
            values[at] = self.elements(numbers["bufferView"], offset, dtype, few, width)
        if entry.get("normalized") is True and values.dtype.kind in "iu":
            scale = np.float32(np.iinfo(values.dtype).max)
            return np.maximum(values.astype(np.float32) / scale, -1.0)
        return values
