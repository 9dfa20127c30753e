"""Read a rig from glTF (.glb, .vrm, .gltf): every mesh of the scene with its morph targets.

Understood are triangles, node transforms, base colour images with their samplers and texture
transforms, and materials that one sees through. A skinned mesh lies where its first joint puts it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from struct import error as StructError
from typing import Any

import numpy as np
import numpy.typing as npt

from pica_core.capture.rig.gltf_file import MAX_ELEMENTS, GltfFile, count_of, extension
from pica_core.capture.rig.source import (
    RigImage,
    RigSource,
    check_counts,
    check_source,
    open_image,
)
from pica_core.errors import CaptureError
from pica_core.types import BoolArray, Float64Array, FloatArray, IntArray

TRIANGLES = 4
MAX_NODE_DEPTH = 64
WRAP = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
CLEAR = 0.5
"""Where a blended material is less opaque than this, it hides nothing."""
MALFORMED = (
    AttributeError, IndexError, KeyError, OverflowError, RecursionError, StructError,
    TypeError, ValueError,
)  # fmt: skip
"""What entries raise that are missing or of another kind than they should be."""


def read_rig(path: Path) -> RigSource:
    """Read a rig from a .glb, .vrm or .gltf file."""
    try:
        with np.errstate(all="ignore"):  # what is not finite is found by `check_source`
            return check_source(_read(GltfFile(path)))
    except MALFORMED as error:
        what = f"{type(error).__name__}: {error}"
        raise CaptureError(f"{path}: malformed, or not as glTF 2.0 has it ({what})") from error


def _matrix(node: dict[str, Any]) -> Float64Array:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
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
    return result


def _placed_meshes(file: GltfFile) -> Iterator[tuple[dict[str, Any], Float64Array]]:
    """Mesh and transform of every node of the scene."""
    roots = list(range(len(file.root.get("nodes", []))))
    if file.root.get("scenes"):
        roots = file.item("scenes", file.root.get("scene", 0)).get("nodes", roots)
    stack = [(k, np.eye(4), 0) for k in roots]
    worlds: dict[int, Float64Array] = {}
    while stack:
        index, parent, depth = stack.pop()
        if depth > MAX_NODE_DEPTH:
            raise CaptureError(f"{file.path}: nodes are nested deeper than {MAX_NODE_DEPTH}")
        node = file.item("nodes", index)
        if index in worlds:
            raise CaptureError(f"{file.path}: node {index} has several parents; one is allowed")
        worlds[index] = parent @ _matrix(node)
        stack += [(k, worlds[index], depth + 1) for k in node.get("children", [])]
    for index, place in worlds.items():
        node = file.item("nodes", index)
        if "mesh" in node:
            if "skin" in node:  # the node's own transform counts for nothing
                skin = file.item("skins", node["skin"])
                joint, inverse = skin["joints"][0], skin.get("inverseBindMatrices")
                place = worlds.get(joint, np.eye(4))
                if inverse is not None:
                    place = place @ file.accessor(inverse, 16)[0].reshape(4, 4).T
            yield file.item("meshes", node["mesh"]), place


def _target_names(
    file: GltfFile, mesh: dict[str, Any], primitive: dict[str, Any], count: int
) -> list[str]:
    for owner in (mesh, primitive):
        names = owner.get("extras", {}).get("targetNames", [])
        if count and len(names) == count:
            return [str(name) for name in names]
    if not count:
        return []
    raise CaptureError(
        f"{file.path}: mesh {mesh.get('name', '')!r} has {count} morph targets and no such list of "
        "names in extras.targetNames; export with names"
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class _Material:
    """What a rig takes from a material."""

    name: str
    uv: str
    """The attribute that holds its texture coordinates."""
    transform: Float64Array
    """What moves texture coordinates, as ``uv @ [:2] + [2]``. ``[3, 2]``."""
    image: RigImage | None
    alpha: float
    """Opacity that the whole material has."""
    cutoff: float | None
    """Opacity from which on it hides what is behind; None: it hides everywhere."""


PLAIN = _Material(
    name="default", uv="TEXCOORD_0", transform=np.eye(3, 2), image=None, alpha=1.0, cutoff=None
)
"""What a primitive without a material has."""


def _material(file: GltfFile, index: int) -> _Material:
    entry = file.item("materials", index)
    pbr = entry.get("pbrMetallicRoughness", {})
    texture = pbr.get("baseColorTexture") or {}
    move = extension(texture, "KHR_texture_transform")
    scale = np.diag(np.array(move.get("scale", [1.0, 1.0]), np.float64).reshape(2))
    turn = float(move.get("rotation", 0.0))
    sine, cosine = np.sin(turn), np.cos(turn)
    linear = scale @ np.array([[cosine, -sine], [sine, cosine]])
    offset = np.array(move.get("offset", [0.0, 0.0]), np.float64).reshape(1, 2)
    mode, cutoff = str(entry.get("alphaMode")), float(entry.get("alphaCutoff", CLEAR))
    return _Material(
        name=str(entry.get("name", f"material {index}")),
        uv=f"TEXCOORD_{move.get('texCoord', texture.get('texCoord', 0))}",
        transform=np.concatenate([linear, offset]),
        image=_image(file, texture["index"]) if "index" in texture else None,
        alpha=float(pbr.get("baseColorFactor", [1.0] * 4)[3]),
        cutoff={"MASK": cutoff, "BLEND": CLEAR}.get(mode),
    )


def _image(file: GltfFile, index: Any) -> RigImage:
    texture = file.item("textures", index)
    other = extension(texture, "EXT_texture_webp")
    sampler = file.item("samplers", texture["sampler"]) if "sampler" in texture else {}
    wrap = WRAP[sampler.get("wrapS", 10497)], WRAP[sampler.get("wrapT", 10497)]
    number = other.get("source", texture.get("source"))
    image = file.item("images", number)
    data = file.resource(image["uri"]) if "uri" in image else None
    if data is None:
        data = bytes(file.view(count_of(image, "bufferView"))[0])
    return RigImage(pixels=open_image(f"{file.path}: image {number}", data), wrap=wrap)


class _Builder:
    """Primitives of all meshes, put one after the other."""

    def __init__(self, file: GltfFile) -> None:
        self.file = file
        count = len(file.root.get("materials", []))
        self.materials = [*(_material(file, k) for k in range(count)), PLAIN]
        self.positions: list[Float64Array] = []
        self.uv: list[Float64Array | None] = []
        self.faces: list[IntArray] = []
        self.material: list[IntArray] = []
        self.targets: list[tuple[str, slice, FloatArray]] = []
        self.count = 0
        self.shared: dict[tuple[Any, ...], slice] = {}

    def add(self, place: Float64Array, mesh: dict[str, Any], primitive: dict[str, Any]) -> None:
        """Add one primitive; primitives on the same vertices share them."""
        file = self.file
        if primitive.get("mode", TRIANGLES) != TRIANGLES:
            return
        attributes = primitive["attributes"]
        number = primitive.get("material", len(self.materials) - 1)
        if not 0 <= number < len(self.materials):
            raise CaptureError(f"{file.path}: materials {number} does not exist")
        look = self.materials[number]
        targets = primitive.get("targets", [])
        names = _target_names(file, mesh, primitive, len(targets))
        at = [target.get("POSITION") for target in targets]
        coordinates = attributes.get(look.uv)
        move = place.tobytes(), look.transform.tobytes()
        key = (attributes["POSITION"], coordinates, *at, *move)
        if key not in self.shared:
            self.shared[key] = self._add_vertices(
                attributes["POSITION"], coordinates, dict(zip(names, at, strict=True)), place, look
            )
        span = self.shared[key]
        count = span.stop - span.start
        index = np.arange(count)
        if "indices" in primitive:
            index = file.accessor(primitive["indices"], 1, 3 * MAX_ELEMENTS)[:, 0].astype(np.int64)
        if len(index) % 3 or not len(index) or index.min() < 0 or index.max() >= count:
            raise CaptureError(
                f"{file.path}: indices {primitive.get('indices')}: {len(index)} indices up to "
                f"{index.max(initial=0)}; triangles of {count} vertices are needed"
            )
        faces = (index.reshape(-1, 3) + span.start).astype(np.int32)
        self.faces.append(faces[:, ::-1] if np.linalg.det(place[:3, :3]) < 0 else faces)
        self.material.append(np.full(len(faces), number, np.int32))

    def _add_vertices(
        self,
        position: int,
        coordinates: int | None,
        targets: dict[str, Any],
        place: Float64Array,
        look: _Material,
    ) -> slice:
        file, linear = self.file, place[:3, :3].T

        def same_count(what: str, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            if len(values) != len(points):
                raise CaptureError(f"{file.path}: {len(points)} vertices, {len(values)} {what}")
            return values

        points = file.accessor(position, 3).astype(np.float64)
        span = slice(self.count, self.count + len(points))
        check_counts(str(file.path), vertices=span.stop, faces=1, shapes=max(len(targets), 1))
        self.positions.append(points @ linear + place[:3, 3])
        uv: Float64Array | None = None
        if coordinates is not None:
            uv = same_count("texture coordinates", file.accessor(coordinates, 2).astype(np.float64))
            uv = uv @ look.transform[:2] + look.transform[2]
        self.uv.append(uv)
        self.count = span.stop
        for name, index in targets.items():
            if index is not None:
                delta = same_count(f"in morph target {name!r}", file.accessor(index, 3))
                moved = (delta.astype(np.float32) @ linear).astype(np.float32)
                self.targets.append((name, span, moved))
        return span


def _read(file: GltfFile) -> RigSource:
    path = file.path
    builder = _Builder(file)
    for mesh, place in _placed_meshes(file):
        for primitive in mesh["primitives"]:
            builder.add(place, mesh, primitive)
    if not builder.faces:
        raise CaptureError(f"{path}: no triangles")
    check_counts(
        str(path),
        vertices=builder.count,
        faces=sum(map(len, builder.faces)),
        shapes=len({name for name, _, _ in builder.targets}),
    )
    shapes: dict[str, FloatArray] = {}
    for name, span, delta in builder.targets:
        shapes.setdefault(name, np.zeros((builder.count, 3), np.float32))[span] += delta
    faces = np.concatenate(builder.faces)
    material = np.concatenate(builder.material)
    names = [look.name for look in builder.materials]
    if material.max() < len(names) - 1:
        names.pop()  # PLAIN is not needed
    uv: Float64Array | None = None
    if any(part is not None for part in builder.uv):  # what has none gets islands of its own
        each = zip(builder.uv, builder.positions, strict=True)
        uv = np.concatenate([np.zeros((len(p), 2)) if part is None else part for part, p in each])
    return RigSource(
        path=path,
        positions=np.concatenate(builder.positions),
        faces=faces,
        uv=uv,
        materials=tuple(names),
        face_material=material,
        shapes=shapes,
        copyright=str(file.root.get("asset", {}).get("copyright", ""))[:500],
        images={k: m.image for k, m in enumerate(builder.materials) if m.image is not None},
        see_through=_see_through(builder.materials, faces, material, uv),
    )


def _see_through(
    materials: list[_Material], faces: IntArray, material: IntArray, uv: Float64Array | None
) -> BoolArray:
    """Triangles of lenses, tear films and cut-out cards whose middle hides little. bool ``[F]``."""
    clear = np.zeros(len(faces), np.bool_)
    for index, look in enumerate(materials):
        mine = np.flatnonzero(material == index)
        if look.cutoff is None:
            continue
        alpha = np.full(len(mine), look.alpha)
        if look.image is not None and uv is not None:
            opacity = look.image.pixels[..., 3]
            height, width = opacity.shape
            place = np.mod(uv[faces[mine]].mean(1), 1.0) * [width, height]
            column, row = np.minimum(place, [width - 1, height - 1]).astype(np.int64).T
            alpha *= opacity[row, column] / 255
        clear[mine] = alpha < look.cutoff
    return clear
