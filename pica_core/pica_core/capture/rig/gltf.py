"""Read a rig from glTF (.glb, .vrm, .gltf): every mesh of the scene with its morph targets.

Understood are triangles, node transforms, base colour images with their
samplers and texture transforms, materials that one sees through, and the expressions of VRM. Skins
are taken in the pose that the vertices are stored in.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from struct import error as StructError
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pica_core.capture.rig.gltf_file import MAX_ELEMENTS, GltfFile, count_of, extension
from pica_core.capture.rig.source import (
    RigImage,
    RigSource,
    check_counts,
    check_source,
    open_image,
    see_through,
)
from pica_core.errors import CaptureError
from pica_core.types import BoolArray, Float64Array, FloatArray, IntArray

TRIANGLES = 4
MAX_NODE_DEPTH = 64
FLOAT = 5126
VRM = ("VRMC_vrm", "VRM")
WRAP = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
CLEAR = 0.5
"""Where a blended material is less opaque than this, it hides nothing."""
MALFORMED = (
    AttributeError, IndexError, KeyError, OverflowError, RecursionError, StructError,
    TypeError, ValueError,
)  # fmt: skip
"""What entries raise that are missing or of another kind than they should be."""


def read_glb(path: Path) -> RigSource:
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


class _Placed(NamedTuple):
    """A mesh where a node puts it."""

    node: int
    mesh: int
    place: Float64Array


def _placed_meshes(file: GltfFile) -> Iterator[_Placed]:
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
            if "skin" in node:
                place = _bind_place(file, node, worlds)
            yield _Placed(node=index, mesh=node["mesh"], place=place)


def _bind_place(
    file: GltfFile, node: dict[str, Any], worlds: dict[int, Float64Array]
) -> Float64Array:
    """Where a skinned mesh lies as it is stored: its node's transform counts for nothing.

    Quantised skinned meshes hide what undoes it in their inverse bind matrices.
    """
    for primitive in file.item("meshes", node["mesh"])["primitives"]:
        at = primitive["attributes"]["POSITION"]
        if file.item("accessors", at)["componentType"] != FLOAT:
            skin = file.item("skins", node["skin"])
            joints = skin["joints"]
            if joints[0] not in worlds or "inverseBindMatrices" not in skin:
                break
            inverse = file.accessor(skin["inverseBindMatrices"], 16)[0].reshape(4, 4).T
            return worlds[joints[0]] @ inverse
    return np.eye(4)


def _target_names(
    file: GltfFile, mesh: dict[str, Any], primitive: dict[str, Any], count: int
) -> list[str]:
    for owner in (mesh, primitive):
        names = owner.get("extras", {}).get("targetNames", [])
        if count and len(names) == count:
            return [str(name) for name in names]
    if not count or extension(file.root, *VRM)[0]:  # its expressions name what they need
        return [f"{mesh.get('name', '')}#{k}" for k in range(count)]
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
    _, old = extension(entry, "KHR_materials_pbrSpecularGlossiness")
    texture = pbr.get("baseColorTexture") or old.get("diffuseTexture") or {}
    _, move = extension(texture, "KHR_texture_transform")
    scale = np.diag(np.array(move.get("scale", [1.0, 1.0]), np.float64).reshape(2))
    turn = float(move.get("rotation", 0.0))
    sine, cosine = np.sin(turn), np.cos(turn)
    linear = scale @ np.array([[cosine, -sine], [sine, cosine]])
    offset = np.array(move.get("offset", [0.0, 0.0]), np.float64).reshape(1, 2)
    _, glass = extension(entry, "KHR_materials_transmission")
    passed = float(glass.get("transmissionFactor", 0.0))
    mode, cutoff = entry.get("alphaMode"), float(entry.get("alphaCutoff", CLEAR))
    hides_partly = mode in ("MASK", "BLEND") or passed
    return _Material(
        name=str(entry.get("name", f"material {index}")),
        uv=f"TEXCOORD_{move.get('texCoord', texture.get('texCoord', 0))}",
        transform=np.concatenate([linear, offset]),
        image=_image(file, texture["index"]) if "index" in texture else None,
        alpha=float(pbr.get("baseColorFactor", [1.0] * 4)[3]) * (1 - passed),
        cutoff=(cutoff if mode == "MASK" else CLEAR) if hides_partly else None,
    )


def _image(file: GltfFile, index: Any) -> RigImage | None:
    texture = file.item("textures", index)
    _, other = extension(texture, "EXT_texture_webp")
    sampler = file.item("samplers", texture["sampler"]) if "sampler" in texture else {}
    wrap = WRAP[sampler.get("wrapS", 10497)], WRAP[sampler.get("wrapT", 10497)]
    image = file.item("images", other.get("source", texture.get("source")))
    if "uri" in image:
        return RigImage(data=file.resource(image["uri"]), wrap=wrap)
    return RigImage(data=bytes(file.view(count_of(image, "bufferView"))[0]), wrap=wrap)


class _Target(NamedTuple):
    """A morph target of one primitive; VRM names it by mesh or node, and number."""

    span: slice
    name: str
    delta: FloatArray
    placed: _Placed
    number: int


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
        self.targets: list[_Target] = []
        self.count = 0
        self.shared: dict[tuple[Any, ...], slice] = {}

    def add(self, placed: _Placed, mesh: dict[str, Any], primitive: dict[str, Any]) -> None:
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
        move = placed.place.tobytes(), look.transform.tobytes()
        key = (attributes["POSITION"], coordinates, *at, *move)
        if key not in self.shared:
            self.shared[key] = self._add_vertices(
                attributes["POSITION"], coordinates, dict(zip(names, at, strict=True)), placed, look
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
        self.faces.append(faces[:, ::-1] if np.linalg.det(placed.place[:3, :3]) < 0 else faces)
        self.material.append(np.full(len(faces), number, np.int32))

    def _add_vertices(
        self,
        position: int,
        coordinates: int | None,
        targets: dict[str, Any],
        placed: _Placed,
        look: _Material,
    ) -> slice:
        file, linear = self.file, placed.place[:3, :3].T

        def same_count(what: str, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            if len(values) != len(points):
                raise CaptureError(f"{file.path}: {len(points)} vertices, {len(values)} {what}")
            return values

        points = file.accessor(position, 3).astype(np.float64)
        span = slice(self.count, self.count + len(points))
        check_counts(str(file.path), vertices=span.stop, faces=1, shapes=max(len(targets), 1))
        self.positions.append(points @ linear + placed.place[:3, 3])
        uv: Float64Array | None = None
        if coordinates is not None:
            uv = same_count("texture coordinates", file.accessor(coordinates, 2).astype(np.float64))
            uv = uv @ look.transform[:2] + look.transform[2]
        self.uv.append(uv)
        self.count = span.stop
        for number, (name, index) in enumerate(targets.items()):
            if index is not None:
                delta = same_count(f"in morph target {name!r}", file.accessor(index, 3))
                moved = (delta.astype(np.float32) @ linear).astype(np.float32)
                self.targets.append(_Target(span, name, moved, placed, number))
        return span


def _expressions(file: GltfFile, targets: list[_Target]) -> dict[str, list[tuple[_Target, float]]]:
    """The expressions of VRM: what each adds up of morph targets; 0.x counts in hundredths."""
    version, vrm = extension(file.root, *VRM)
    found: list[tuple[Any, Any, str, float]] = []
    if version == "VRM":
        for group in vrm.get("blendShapeMaster", {}).get("blendShapeGroups", []):
            preset = group.get("presetName")
            name = preset if preset not in ("", "unknown", None) else group.get("name")
            found.append((name, group.get("binds", []), "mesh", 0.01))
    elif version:
        for part in ("preset", "custom"):
            for name, some in vrm.get("expressions", {}).get(part, {}).items():
                found.append((name, some.get("morphTargetBinds", []), "node", 1.0))
    result: dict[str, list[tuple[_Target, float]]] = {}
    for name, binds, owner, scale in found:
        for bind in binds:
            weight = float(bind.get("weight", 1 / scale))
            place = bind.get(owner), bind.get("index")
            for target in targets:
                if place == (getattr(target.placed, owner), target.number):
                    result.setdefault(str(name), []).append((target, weight * scale))
    return result


def _read(file: GltfFile) -> RigSource:
    path = file.path
    builder = _Builder(file)
    for placed in _placed_meshes(file):
        mesh = file.item("meshes", placed.mesh)
        for primitive in mesh["primitives"]:
            builder.add(placed, mesh, primitive)
    if not builder.faces:
        raise CaptureError(f"{path}: no triangles")
    more = _expressions(file, builder.targets)
    check_counts(
        str(path),
        vertices=builder.count,
        faces=sum(map(len, builder.faces)),
        shapes=len({target.name for target in builder.targets} | set(more)),
    )
    own = {target.name for target in builder.targets}
    parts = [(target.name, target, 1.0) for target in builder.targets]
    parts += [(name, *part) for name in more if name not in own for part in more[name]]
    shapes: dict[str, FloatArray] = {}
    for name, target, weight in parts:
        whole = shapes.setdefault(name, np.zeros((builder.count, 3), np.float32))
        whole[target.span] += np.float32(weight) * target.delta
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
        uv_faces=faces if uv is not None else None,
        materials=tuple(names),
        face_material=material,
        shapes=shapes,
        split_at_seams=True,
        copyright=str(file.root.get("asset", {}).get("copyright", ""))[:500],
        images={k: m.image for k, m in enumerate(builder.materials) if m.image is not None},
        see_through=_see_through(file, builder.materials, faces, material, uv),
    )


def _see_through(
    file: GltfFile,
    materials: list[_Material],
    faces: IntArray,
    material: IntArray,
    uv: Float64Array | None,
) -> BoolArray:
    """Triangles of lenses, tear films and cut-out cards that hide little. bool ``[F]``."""
    clear = np.zeros(len(faces), np.bool_)
    for index, look in enumerate(materials):
        mine = material == index
        if look.cutoff is None or not mine.any():
            continue
        if look.image is None or uv is None or look.alpha < look.cutoff:
            clear[mine] = look.alpha < look.cutoff
            continue
        pixels = open_image(f"{file.path}: image of material {look.name!r}", look.image.data)
        alpha = pixels[..., 3].astype(np.float64) * (look.alpha / 255)
        clear[mine] = see_through(alpha, look.cutoff, uv[faces[mine]], look.image.wrap)
    return clear
