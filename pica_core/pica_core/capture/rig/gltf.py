"""Read a rig from a binary glTF file (.glb): every mesh of the scene with its morph targets.

Read here without a library, because a rig may come from a stranger: each offset, count and index is
checked before it is used. Understood are triangles, sparse accessors, normalised integers, node
transforms and embedded base colour images. Not understood, and said so: compressed meshes and files
beside the .glb. Skins are taken in the pose that the vertices are stored in.
"""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from pica_core.capture.dataset.files import read_bytes
from pica_core.capture.rig.source import RigSource, check_counts, check_source
from pica_core.errors import CaptureError
from pica_core.types import Array, Float64Array, FloatArray, IntArray

MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
COMPONENT = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
TRIANGLES = 4
MAX_NODE_DEPTH = 64
MAX_ELEMENTS = 1_000_000
UNDERSTOOD = ("KHR_mesh_quantization", "KHR_materials_unlit")
"""Required extensions that change nothing for us."""


class _File:
    """The two chunks of a .glb, with every access checked."""

    def __init__(self, path: Path) -> None:
        self.path = path
        data = read_bytes(path)
        if len(data) < 20:
            raise CaptureError(f"{path}: {len(data)} bytes; a .glb file has at least 20")
        magic, version, length = struct.unpack_from("<III", data)
        if magic != MAGIC or version != 2:
            raise CaptureError(f"{path}: not a binary glTF 2.0 file")
        if length != len(data):
            raise CaptureError(f"{path}: {len(data)} bytes; its header says {length}")
        chunks: dict[int, bytes] = {}
        at = 12
        while at + 8 <= len(data):
            size, kind = struct.unpack_from("<II", data, at)
            if size > len(data) - at - 8:
                raise CaptureError(f"{path}: a chunk of {size} bytes does not fit into the file")
            chunks.setdefault(kind, data[at + 8 : at + 8 + size])
            at += 8 + size
        try:
            self.root = json.loads(chunks.get(JSON_CHUNK, b"").decode("utf-8"))
        except (ValueError, RecursionError) as error:
            raise CaptureError(f"{path}: the JSON chunk cannot be read ({error})") from error
        if not isinstance(self.root, dict):
            raise CaptureError(f"{path}: the JSON chunk is no object")
        self.binary = chunks.get(BINARY_CHUNK, b"")
        for extension in self.entries(self.root, "extensionsRequired"):
            if extension not in UNDERSTOOD:
                raise CaptureError(
                    f"{path}: needs the extension {extension!r}; export without compression"
                )

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

    def view(self, index: Any) -> tuple[int, int, int]:
        """Start, length and stride of a buffer view; all lie in the binary chunk."""
        view = self.item("bufferViews", index)
        if self.number(view, "buffer") != 0 or "uri" in self.item("buffers", 0):
            raise CaptureError(f"{self.path}: data in files beside the .glb are not read; embed it")
        start, length = self.number(view, "byteOffset", 0), self.number(view, "byteLength")
        if start + length > len(self.binary):
            raise CaptureError(
                f"{self.path}: bufferViews {index} ends at byte {start + length} of "
                f"{len(self.binary)}"
            )
        return start, length, self.number(view, "byteStride", 0)

    def _elements(self, index: Any, offset: int, dtype: str, count: int, width: int) -> Any:
        start, length, stride = self.view(index)
        item = np.dtype(dtype).itemsize
        size = item * width
        stride = stride or size
        if count < 1 or stride < size or offset + stride * (count - 1) + size > length:
            raise CaptureError(
                f"{self.path}: {count} elements of {size} bytes do not fit into bufferViews {index}"
            )
        place = start + offset
        return np.ndarray((count, width), dtype, self.binary, place, (stride, item))

    def accessor(self, index: Any, width: int, limit: int = MAX_ELEMENTS) -> Array:
        """An accessor's numbers, ``[count, width]``; integers that are normalised become floats."""
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
        if "bufferView" in entry:
            offset = self.number(entry, "byteOffset", 0)
            values = self._elements(entry["bufferView"], offset, dtype, count, width).copy()
        else:
            values = np.zeros((count, width), dtype)
        sparse = entry.get("sparse")
        if isinstance(sparse, dict):
            self._fill_sparse(sparse, values, dtype, index)
        if entry.get("normalized") is True and dtype != "<f4":
            scale = np.float32(np.iinfo(dtype).max)
            return np.maximum(values.astype(np.float32) / scale, -1.0)
        return values

    def _fill_sparse(self, sparse: dict[str, Any], values: Array, dtype: str, index: Any) -> None:
        few = self.number(sparse, "count")
        if few == 0:
            return
        places, numbers = sparse.get("indices"), sparse.get("values")
        if not isinstance(places, dict) or not isinstance(numbers, dict) or few > len(values):
            raise CaptureError(f"{self.path}: accessors {index}: field 'sparse' cannot be read")
        place_type = _component(places)
        if place_type not in ("<u1", "<u2", "<u4"):
            raise CaptureError(f"{self.path}: accessors {index}: sparse indices are no integers")
        offset = self.number(places, "byteOffset", 0)
        at = self._elements(places.get("bufferView"), offset, place_type, few, 1)[:, 0].astype("i8")
        if at.max() >= len(values):
            raise CaptureError(
                f"{self.path}: accessors {index}: sparse index {at.max()} of {len(values)}"
            )
        offset, width = self.number(numbers, "byteOffset", 0), values.shape[1]
        values[at] = self._elements(numbers.get("bufferView"), offset, dtype, few, width)


def _component(entry: dict[str, Any]) -> str | None:
    """The numpy type of an accessor's numbers, or None."""
    kind = entry.get("componentType")
    return COMPONENT.get(kind) if isinstance(kind, int) else None


def _matrix(file: _File, node: dict[str, Any]) -> Float64Array:
    try:
        if "matrix" in node:
            result = np.array(node["matrix"], np.float64).reshape(4, 4).T
        else:
            result = np.eye(4)
            x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), np.float64)
            turn = np.array(
                [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
                ]
            )
            result[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]), np.float64).reshape(3)
            result[:3, 3] = np.array(node.get("translation", [0, 0, 0]), np.float64).reshape(3)
    except (TypeError, ValueError) as error:
        raise CaptureError(f"{file.path}: a node's transform cannot be read ({error})") from error
    if not np.isfinite(result).all():
        raise CaptureError(f"{file.path}: a node's transform is not finite")
    return result


def _placed_meshes(file: _File) -> list[tuple[int, Float64Array]]:
    """Mesh and transform of every node of the scene."""
    nodes = file.entries(file.root, "nodes")
    scene = file.item("scenes", file.root.get("scene", 0)) if file.root.get("scenes") else {}
    roots = file.entries(scene, "nodes") if "nodes" in scene else list(range(len(nodes)))
    stack = [(k, np.eye(4), 0) for k in roots]
    placed: list[tuple[int, Float64Array]] = []
    while stack:
        index, parent, depth = stack.pop()
        if depth > MAX_NODE_DEPTH or len(placed) > 1000:
            raise CaptureError(f"{file.path}: nodes are nested deeper than {MAX_NODE_DEPTH}")
        node = file.item("nodes", index)
        world = parent @ _matrix(file, node)
        if "mesh" in node:
            # The glTF rule: a skinned mesh ignores its node's transform.
            placed.append((node["mesh"], np.eye(4) if "skin" in node else world))
        stack.extend((child, world, depth + 1) for child in file.entries(node, "children"))
    return placed


def _target_names(file: _File, mesh: dict[str, Any], count: int) -> list[str]:
    extras = mesh.get("extras")
    names = extras.get("targetNames") if isinstance(extras, dict) else None
    if isinstance(names, list) and len(names) == count and all(isinstance(n, str) for n in names):
        return names
    raise CaptureError(
        f"{file.path}: mesh {mesh.get('name', '')!r} has {count} morph targets and no such list of "
        "names in extras.targetNames; export with names"
    )


class _Builder:
    """Primitives of all meshes, put one after the other."""

    def __init__(self, file: _File) -> None:
        self.file = file
        self.positions: list[Float64Array] = []
        self.uv: list[Float64Array | None] = []
        self.faces: list[IntArray] = []
        self.material: list[IntArray] = []
        self.targets: list[tuple[slice, str, FloatArray]] = []
        self.count = 0
        self.shared: dict[tuple[Any, ...], slice] = {}

    def add(self, primitive: dict[str, Any], names: list[str], place: Float64Array) -> None:
        """Add one primitive; primitives on the same vertices share them."""
        file = self.file
        if primitive.get("mode", TRIANGLES) != TRIANGLES:
            return
        attributes = primitive.get("attributes")
        if not isinstance(attributes, dict) or "POSITION" not in attributes:
            raise CaptureError(f"{file.path}: a primitive has no attribute POSITION")
        targets = file.entries(primitive, "targets")
        at = [t.get("POSITION") if isinstance(t, dict) else None for t in targets]
        for index in (attributes["POSITION"], attributes.get("TEXCOORD_0"), *at):
            if index is not None and not isinstance(index, int):
                raise CaptureError(f"{file.path}: accessors {index!r} does not exist")
        key = (attributes["POSITION"], attributes.get("TEXCOORD_0"), *at, place.tobytes())
        if key not in self.shared:
            self.shared[key] = self._add_vertices(attributes, at, names, place)
        span = self.shared[key]
        count = span.stop - span.start
        index = np.arange(count)
        if "indices" in primitive:
            index = file.accessor(primitive["indices"], 1, 3 * MAX_ELEMENTS)[:, 0].astype(np.int64)
        if len(index) % 3 or index.min() < 0 or index.max() >= count:
            raise CaptureError(
                f"{file.path}: indices {primitive.get('indices')}: {len(index)} indices up to "
                f"{index.max()}; triangles of {count} vertices are needed"
            )
        faces = (index.reshape(-1, 3) + span.start).astype(np.int32)
        self.faces.append(faces[:, ::-1] if np.linalg.det(place[:3, :3]) < 0 else faces)
        material = primitive.get("material")
        if material is None:
            material = -1
        else:
            file.item("materials", material)
        self.material.append(np.full(len(faces), material, np.int32))

    def _add_vertices(
        self, attributes: dict[str, Any], targets: list[Any], names: list[str], place: Float64Array
    ) -> slice:
        file = self.file
        points = file.accessor(attributes["POSITION"], 3).astype(np.float64)
        span = slice(self.count, self.count + len(points))
        check_counts(str(file.path), vertices=span.stop, faces=1, shapes=max(len(names), 1))
        self.positions.append(points @ place[:3, :3].T + place[:3, 3])
        uv: Float64Array | None = None
        if "TEXCOORD_0" in attributes:
            uv = file.accessor(attributes["TEXCOORD_0"], 2).astype(np.float64)
            if len(uv) != len(points):
                raise CaptureError(
                    f"{file.path}: {len(points)} positions and {len(uv)} texture coordinates"
                )
        self.uv.append(uv)
        self.count = span.stop
        for name, index in zip(names, targets, strict=True):
            if index is None:
                continue
            delta = file.accessor(index, 3).astype(np.float32)
            if len(delta) != len(points):
                raise CaptureError(
                    f"{file.path}: morph target {name!r} has {len(delta)} vertices, its mesh "
                    f"{len(points)}"
                )
            self.targets.append((span, name, (delta @ place[:3, :3].T).astype(np.float32)))
        return span


def _images(file: _File) -> dict[int, bytes]:
    """Encoded base colour images by material."""
    found: dict[int, bytes] = {}
    for index in range(len(file.entries(file.root, "materials"))):
        pbr = file.item("materials", index).get("pbrMetallicRoughness")
        texture = pbr.get("baseColorTexture") if isinstance(pbr, dict) else None
        if not isinstance(texture, dict):
            continue
        image = file.item("images", file.item("textures", texture.get("index")).get("source"))
        if "bufferView" in image:
            start, length, _ = file.view(image["bufferView"])
            found[index] = file.binary[start : start + length]
    return found


def read_glb(path: Path) -> RigSource:
    """Read a rig from a .glb file."""
    with np.errstate(all="ignore"):  # what is not finite is found by `check_source`
        return check_source(_read(_File(path)))


def _read(file: _File) -> RigSource:
    path = file.path
    builder = _Builder(file)
    for mesh_index, place in _placed_meshes(file):
        mesh = file.item("meshes", mesh_index)
        for primitive in file.entries(mesh, "primitives"):
            if not isinstance(primitive, dict):
                raise CaptureError(f"{path}: meshes {mesh_index}: a primitive is no object")
            count = len(file.entries(primitive, "targets"))
            builder.add(primitive, _target_names(file, mesh, count) if count else [], place)
    if not builder.faces:
        raise CaptureError(f"{path}: no triangles")
    check_counts(
        str(path),
        vertices=builder.count,
        faces=sum(map(len, builder.faces)),
        shapes=len({name for _, name, _ in builder.targets}),
    )
    shapes: dict[str, FloatArray] = {}
    for span, name, delta in builder.targets:
        whole = shapes.setdefault(name, np.zeros((builder.count, 3), np.float32))
        whole[span] = delta
    asset = file.root.get("asset")
    uv = [part for part in builder.uv if part is not None]
    has_uv = len(uv) == len(builder.uv)
    faces = np.concatenate(builder.faces)
    material = np.concatenate(builder.material)
    entries = [file.item("materials", k) for k in range(len(file.entries(file.root, "materials")))]
    names = [str(entry.get("name", f"material {k}")) for k, entry in enumerate(entries)]
    if (material < 0).any():
        material = np.where(material < 0, len(names), material).astype(np.int32)
        names.append("default")
    return RigSource(
        path=path,
        positions=np.concatenate(builder.positions),
        faces=faces,
        uv=np.concatenate(uv) if has_uv else None,
        uv_faces=faces if has_uv else None,
        materials=tuple(names),
        face_material=material,
        shapes=shapes,
        split_at_seams=True,
        copyright=str(asset.get("copyright", ""))[:500] if isinstance(asset, dict) else "",
        images=_images(file),
    )
