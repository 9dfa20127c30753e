"""A glTF 2.0 file as bytes and numbers: .glb, .vrm, or .gltf with files beside it.

Read here without a library, since none that we found reads morph targets and checks what it reads
(trimesh drops them, pygltflib gives the JSON document and little more). A rig may come from a
stranger: sizes are limited before anything is allocated, and numpy checks that arrays lie in their
buffers. An entry that is missing or of another kind is the `KeyError`, `TypeError` ... of its use,
which `gltf.read_rig` turns into a `CaptureError`.

    buffers -> views -> accessors (sparse, normalised)
"""

import base64
import json
import struct
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from pica_core.capture.dataset.multiface import MAX_FILE_BYTES, read_bytes
from pica_core.errors import CaptureError
from pica_core.types import Array

MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
COMPONENT = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
MAX_ELEMENTS = 1_000_000
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
        self._beside = cache(read_bytes)
        self._beside_bytes = 0

    def _glb(self, data: bytes) -> bytes:
        """The JSON document of a binary file, whose buffer is kept."""
        magic, version, length = struct.unpack_from("<III", data)
        if magic != MAGIC or version != 2:
            raise CaptureError(f"{self.path}: not a binary glTF 2.0 file")
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
