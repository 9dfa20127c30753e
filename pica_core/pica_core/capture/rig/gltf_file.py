"""A glTF 2.0 file as bytes and numbers: .glb, .vrm, or .gltf with files beside it.

Read here without a library: a rig may come from a stranger, so each offset, count and index is
checked before it is used, which no reader that we found does (trimesh drops morph targets,
pygltflib gives the JSON document and little more).

    buffers -> views (plain, or EXT/KHR_meshopt_compression) -> accessors (sparse, normalised)
"""

import base64
import json
import struct
from functools import cache, lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from pica_core.capture.dataset.files import MAX_FILE_BYTES, read_bytes
from pica_core.errors import CaptureError
from pica_core.types import Array

MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
COMPONENT = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
MAX_ELEMENTS = 1_000_000
MAX_UNPACKED_BYTES = 64 * MAX_ELEMENTS
MESHOPT = ("KHR_meshopt_compression", "EXT_meshopt_compression")
DRACO = "KHR_draco_mesh_compression"
UNDERSTOOD = (
    *MESHOPT, DRACO, "KHR_mesh_quantization", "KHR_texture_transform", "KHR_texture_basisu",
    "EXT_texture_webp", "VRM",
)  # fmt: skip
"""Required extensions that are read; those that say how light meets a surface change nothing."""
HARMLESS = ("KHR_materials_", "VRMC_")


def missing_wheel(where: str, extension: str) -> CaptureError:
    """What to install for a compressed file."""
    return CaptureError(f"{where}: {extension} needs pip install 'pica-telepresence[rigs]'")


def child(owner: Any, name: str) -> dict[str, Any]:
    """An object inside another; empty where either is missing or is none."""
    value = owner.get(name) if isinstance(owner, dict) else None
    return value if isinstance(value, dict) else {}


class GltfFile:
    """One file and what lies beside it, with every access checked."""

    def __init__(self, path: Path) -> None:
        self.path = path
        data = read_bytes(path)
        self._binary: bytes | None = None
        text = self._glb_chunks(data) if data[:4] == b"glTF" or path.suffix != ".gltf" else data
        try:
            self.root = json.loads(text.decode("utf-8"))
        except (ValueError, RecursionError) as error:
            raise CaptureError(f"{path}: the JSON document cannot be read ({error})") from error
        if not isinstance(self.root, dict):
            raise CaptureError(f"{path}: the JSON document is no object")
        for extension in self.entries(self.root, "extensionsRequired"):
            if extension not in UNDERSTOOD and not str(extension).startswith(HARMLESS):
                raise CaptureError(
                    f"{path}: needs the extension {extension!r}, which is not read here; "
                    "export without it"
                )
        self.buffer = cache(self._buffer)
        self._beside = cache(read_bytes)
        self._beside_bytes = 0
        self.view = lru_cache(maxsize=8)(self._view)

    def _glb_chunks(self, data: bytes) -> bytes:
        if len(data) < 20:
            raise CaptureError(f"{self.path}: {len(data)} bytes; a .glb file has at least 20")
        magic, version, length = struct.unpack_from("<III", data)
        if magic != MAGIC or version != 2:
            raise CaptureError(f"{self.path}: not a binary glTF 2.0 file")
        if length != len(data):
            raise CaptureError(f"{self.path}: {len(data)} bytes; its header says {length}")
        chunks: dict[int, bytes] = {}
        at = 12
        while at + 8 <= len(data):
            size, kind = struct.unpack_from("<II", data, at)
            if size > len(data) - at - 8:
                raise CaptureError(f"{self.path}: a chunk of {size} bytes does not fit into it")
            chunks.setdefault(kind, data[at + 8 : at + 8 + size])
            at += 8 + size
        self._binary = chunks.get(BINARY_CHUNK, b"")
        return chunks.get(JSON_CHUNK, b"")

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """One entry of a top-level list such as ``accessors``."""
        entries = self.root.get(kind, [])
        if not (isinstance(index, int) and isinstance(entries, list) and 0 <= index < len(entries)):
            raise CaptureError(f"{self.path}: {kind} {index!r} does not exist")
        entry = entries[index]
        if not isinstance(entry, dict):
            raise CaptureError(f"{self.path}: {kind} {index} is no object")
        return entry

    def entries(self, owner: dict[str, Any], name: str) -> list[Any]:
        """A list inside an entry; empty where it is missing."""
        value = owner.get(name, [])
        if not isinstance(value, list):
            raise CaptureError(f"{self.path}: field {name!r} is {value!r}; a list is needed")
        return value

    def number(self, owner: dict[str, Any], name: str, default: int | None = None) -> int:
        """A count, offset or index that is not negative."""
        value = owner.get(name, default)
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise CaptureError(f"{self.path}: field {name!r} is {value!r}; 0 or more is needed")
        return value

    def extension(self, owner: dict[str, Any], *names: str) -> tuple[str, dict[str, Any]]:
        """Name and content of the first of these extensions that an entry has, or two blanks."""
        found = child(owner, "extensions")
        for name in names:
            if isinstance(found.get(name), dict):
                return name, found[name]
        return "", {}

    def resource(self, uri: Any) -> bytes:
        """What a URI names: data in the document, or a file in the folder of this one."""
        if not isinstance(uri, str):
            raise CaptureError(f"{self.path}: uri is {uri!r}; text is needed")
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(";base64,")[2], validate=True)
            except ValueError as error:
                raise CaptureError(f"{self.path}: a data URI is not base64 ({error})") from error
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

    def _span(self, owner: dict[str, Any], what: str) -> memoryview:
        """The bytes of its buffer that a view, or its compressed form, names."""
        data = self.buffer(self.number(owner, "buffer"))
        start, length = self.number(owner, "byteOffset", 0), self.number(owner, "byteLength")
        if start + length > len(data):
            raise CaptureError(f"{self.path}: {what} ends at byte {start + length} of {len(data)}")
        return memoryview(data)[start : start + length]

    def _view(self, index: int) -> tuple[memoryview, int]:
        """Content and stride of a buffer view; stride 0: one element after the other."""
        view, what = self.item("bufferViews", index), f"bufferViews {index}"
        name, packed = self.extension(view, *MESHOPT)
        if not packed:
            return self._span(view, what), self.number(view, "byteStride", 0)
        data = self._span(packed, what)
        count, stride = self.number(packed, "count"), self.number(packed, "byteStride")
        if count * stride > MAX_UNPACKED_BYTES:
            raise CaptureError(
                f"{self.path}: {what} unpacks to {count * stride} bytes; at most "
                f"{MAX_UNPACKED_BYTES} are allowed"
            )
        try:
            from meshopt import decode_gltf_buffer
        except ImportError:
            raise missing_wheel(str(self.path), name) from None
        mode, how = packed.get("mode"), packed.get("filter", "NONE")
        try:
            rows = decode_gltf_buffer(data, count, stride, mode, how)
        except (ValueError, TypeError, RuntimeError) as error:
            raise CaptureError(f"{self.path}: {what} cannot be unpacked ({error})") from error
        return memoryview(rows.tobytes()), stride if mode == "ATTRIBUTES" else 0

    def elements(self, index: Any, offset: int, dtype: str, count: int, width: int) -> Array:
        """Numbers of a buffer view as they are stored. ``[count, width]``."""
        if not isinstance(index, int):
            raise CaptureError(f"{self.path}: bufferViews {index!r} does not exist")
        data, stride = self.view(index)
        item = np.dtype(dtype).itemsize
        size = item * width
        stride = stride or size
        if count < 1 or stride < size or offset + stride * (count - 1) + size > len(data):
            raise CaptureError(
                f"{self.path}: {count} elements of {size} bytes do not fit into bufferViews {index}"
            )
        return np.ndarray((count, width), dtype, data, offset, (stride, item))

    def accessor(
        self,
        index: Any,
        width: int,
        limit: int = MAX_ELEMENTS,
        unpacked: Array | None = None,
    ) -> Array:
        """An accessor's numbers, ``[count, width]``; integers that are normalised become floats.

        `unpacked` are the numbers where they do not lie in a buffer view (Draco).
        """
        entry = self.item("accessors", index)
        dtype = _component(entry)
        count = self.number(entry, "count")
        kind = entry.get("type")
        if dtype is None or not isinstance(kind, str) or WIDTH.get(kind) != width:
            raise CaptureError(
                f"{self.path}: accessors {index} is {entry.get('type')!r} of "
                f"{entry.get('componentType')!r}; {width} numbers per element are needed"
            )
        if not 0 < count <= limit:
            raise CaptureError(
                f"{self.path}: accessors {index} has {count} elements; 1 to {limit} are allowed"
            )
        if unpacked is not None:
            if unpacked.shape != (count, width):
                raise CaptureError(
                    f"{self.path}: accessors {index} has {count} elements of {width} numbers; "
                    f"{unpacked.shape} were unpacked"
                )
            values = unpacked
        elif "bufferView" in entry:
            offset = self.number(entry, "byteOffset", 0)
            values = self.elements(entry["bufferView"], offset, dtype, count, width).copy()
        else:
            values = np.zeros((count, width), dtype)
        sparse = entry.get("sparse")
        if isinstance(sparse, dict):
            self._fill_sparse(sparse, values, dtype, index)
        if entry.get("normalized") is True and values.dtype.kind in "iu":
            scale = np.float32(np.iinfo(values.dtype).max)
            return np.maximum(values.astype(np.float32) / scale, -1.0)
        return values

    def _fill_sparse(self, sparse: dict[str, Any], values: Array, dtype: str, index: Any) -> None:
        few = self.number(sparse, "count")
        if few == 0:
            return
        places, numbers = child(sparse, "indices"), child(sparse, "values")
        if not places or not numbers or few > len(values):
            raise CaptureError(f"{self.path}: accessors {index}: field 'sparse' cannot be read")
        place_type = _component(places)
        if place_type not in ("<u1", "<u2", "<u4"):
            raise CaptureError(f"{self.path}: accessors {index}: sparse indices are no integers")
        offset = self.number(places, "byteOffset", 0)
        at = self.elements(places.get("bufferView"), offset, place_type, few, 1)[:, 0].astype("i8")
        if at.max() >= len(values):
            raise CaptureError(
                f"{self.path}: accessors {index}: sparse index {at.max()} of {len(values)}"
            )
        offset, width = self.number(numbers, "byteOffset", 0), values.shape[1]
        values[at] = self.elements(numbers.get("bufferView"), offset, dtype, few, width)


def _component(entry: dict[str, Any]) -> str | None:
    """The numpy type of an accessor's numbers, or None."""
    kind = entry.get("componentType")
    return COMPONENT.get(kind) if isinstance(kind, int) else None
