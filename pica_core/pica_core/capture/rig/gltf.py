"""Read a rig from glTF (.glb, .vrm, .gltf): every mesh of the scene with its morph targets.

Understood are triangles, plain or packed by Draco, node transforms, base colour images with their
samplers and texture transforms, materials that one sees through, and the expressions of VRM. Skins
are taken in the pose that the vertices are stored in.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pica_core.capture.rig.gltf_file import DRACO, MAX_ELEMENTS, GltfFile, child, missing_wheel
from pica_core.capture.rig.source import (
    RigImage,
    RigSource,
    check_counts,
    check_source,
    open_image,
    see_through,
)
from pica_core.errors import CaptureError
from pica_core.types import Array, BoolArray, Float64Array, FloatArray, IntArray

TRIANGLES = 4
MAX_NODE_DEPTH = 64
FLOAT = 5126
VRM = ("VRMC_vrm", "VRM")
WRAP = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
CLEAR = 0.5
"""Where a blended material is less opaque than this, it hides nothing."""


def _matrix(file: GltfFile, node: dict[str, Any]) -> Float64Array:
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


@dataclass(frozen=True, kw_only=True, slots=True)
class _Placed:
    """A mesh where a node puts it."""

    node: int
    mesh: int
    place: Float64Array


def _placed_meshes(file: GltfFile) -> list[_Placed]:
    """Mesh and transform of every node of the scene."""
    nodes = file.entries(file.root, "nodes")
    scene = file.item("scenes", file.root.get("scene", 0)) if file.root.get("scenes") else {}
    roots = file.entries(scene, "nodes") if "nodes" in scene else list(range(len(nodes)))
    stack = [(k, np.eye(4), 0) for k in roots]
    worlds: dict[int, Float64Array] = {}
    found: list[int] = []
    while stack:
        index, parent, depth = stack.pop()
        if depth > MAX_NODE_DEPTH or len(found) > 1000:
            raise CaptureError(f"{file.path}: nodes are nested deeper than {MAX_NODE_DEPTH}")
        node = file.item("nodes", index)
        if index in worlds:
            raise CaptureError(f"{file.path}: node {index} has several parents; one is allowed")
        worlds[index] = parent @ _matrix(file, node)
        if "mesh" in node:
            found.append(index)
        stack += [(k, worlds[index], depth + 1) for k in file.entries(node, "children")]
    placed = []
    for index in found:
        node = file.item("nodes", index)
        place = worlds[index] if "skin" not in node else _bind_place(file, node, worlds)
        placed.append(_Placed(node=index, mesh=node["mesh"], place=place))
    return placed


def _bind_place(
    file: GltfFile, node: dict[str, Any], worlds: dict[int, Float64Array]
) -> Float64Array:
    """Where a skinned mesh lies as it is stored: its node's transform counts for nothing.

    Quantised skinned meshes hide what undoes it in their inverse bind matrices.
    """
    for primitive in file.entries(file.item("meshes", node["mesh"]), "primitives"):
        at = child(primitive, "attributes").get("POSITION")
        if file.item("accessors", at).get("componentType") != FLOAT:
            skin = file.item("skins", node["skin"])
            joints = file.entries(skin, "joints")
            if not joints or joints[0] not in worlds or "inverseBindMatrices" not in skin:
                break
            inverse = file.accessor(skin["inverseBindMatrices"], 16)[0].reshape(4, 4).T
            return worlds[joints[0]] @ inverse
    return np.eye(4)


def _target_names(
    file: GltfFile, mesh: dict[str, Any], primitive: dict[str, Any], count: int
) -> list[str]:
    for owner in (mesh, primitive):
        names = child(owner, "extras").get("targetNames")
        if isinstance(names, list) and len(names) == count:
            return [str(name) for name in names]
    if file.extension(file.root, *VRM)[0]:  # its expressions name what they need
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


def _numbers(file: GltfFile, owner: dict[str, Any], name: str, default: list[float]) -> list[float]:
    value = owner.get(name, default)
    if not isinstance(value, list) or len(value) != len(default) or not all(map(_is_real, value)):
        raise CaptureError(f"{file.path}: field {name!r} is {value!r}; numbers are needed")
    return value


def _is_real(value: Any) -> bool:
    return isinstance(value, (int, float)) and abs(value) < 1e6


def _material(file: GltfFile, index: int) -> _Material:
    entry = file.item("materials", index)
    pbr = child(entry, "pbrMetallicRoughness")
    _, old = file.extension(entry, "KHR_materials_pbrSpecularGlossiness")
    texture = child(pbr, "baseColorTexture") or child(old, "diffuseTexture")
    _, move = file.extension(texture, "KHR_texture_transform")
    turn = move.get("rotation", 0.0)
    if not _is_real(turn):
        raise CaptureError(f"{file.path}: field 'rotation' is {turn!r}; a number is needed")
    scale = np.diag(_numbers(file, move, "scale", [1.0, 1.0]))
    sine, cosine = np.sin(turn), np.cos(turn)
    linear = scale @ np.array([[cosine, -sine], [sine, cosine]])
    offset = _numbers(file, move, "offset", [0.0, 0.0])
    _, glass = file.extension(entry, "KHR_materials_transmission")
    passed = glass.get("transmissionFactor", 0.0)
    alpha = _numbers(file, pbr, "baseColorFactor", [1.0] * 4)[3]
    mode, cutoff = entry.get("alphaMode"), entry.get("alphaCutoff", CLEAR)
    return _Material(
        name=str(entry.get("name", f"material {index}")),
        uv=f"TEXCOORD_{move.get('texCoord', texture.get('texCoord', 0))}",
        transform=np.concatenate([linear, [offset]]),
        image=_image(file, texture["index"]) if "index" in texture else None,
        alpha=alpha * (1 - passed if _is_real(passed) else 1),
        cutoff=(cutoff if mode == "MASK" and _is_real(cutoff) else CLEAR)
        if mode in ("MASK", "BLEND") or passed
        else None,
    )


def _image(file: GltfFile, index: Any) -> RigImage | None:
    texture = file.item("textures", index)
    _, other = file.extension(texture, "KHR_texture_basisu", "EXT_texture_webp")
    sampler = file.item("samplers", texture["sampler"]) if "sampler" in texture else {}
    wrap = [WRAP.get(k) for k in (sampler.get("wrapS", 10497), sampler.get("wrapT", 10497))]
    if wrap[0] is None or wrap[1] is None:
        raise CaptureError(f"{file.path}: a sampler's wrap is none of {', '.join(map(str, WRAP))}")
    image = file.item("images", other.get("source", texture.get("source")))
    if "uri" in image:
        data = file.resource(image["uri"])
    elif "bufferView" in image:
        data = bytes(file.view(file.number(image, "bufferView"))[0])
    else:
        return None
    return RigImage(data=data, wrap=(wrap[0], wrap[1]))


@dataclass(frozen=True, kw_only=True, slots=True)
class _Target:
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
        count = len(file.entries(file.root, "materials"))
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
        attributes = child(primitive, "attributes")
        if "POSITION" not in attributes:
            raise CaptureError(f"{file.path}: a primitive has no attribute POSITION")
        number = primitive.get("material")
        if number is None:
            number = len(self.materials) - 1
        else:
            file.item("materials", number)
        look = self.materials[number]
        targets = file.entries(primitive, "targets")
        names = _target_names(file, mesh, primitive, len(targets)) if targets else []
        at = [t.get("POSITION") if isinstance(t, dict) else None for t in targets]
        coordinates = attributes.get(look.uv)
        for index in (attributes["POSITION"], coordinates, *at):
            if index is not None and not isinstance(index, int):
                raise CaptureError(f"{file.path}: accessors {index!r} does not exist")
        packed = _unpack(file, primitive)
        move = placed.place.tobytes(), look.transform.tobytes()
        key = (attributes["POSITION"], coordinates, *at, *move, id(packed))
        if packed is not None or key not in self.shared:
            self.shared[key] = self._add_vertices(
                attributes, coordinates, dict(zip(names, at, strict=True)), placed, look, packed
            )
        span = self.shared[key]
        count = span.stop - span.start
        index = np.arange(count)
        if packed is not None:
            index = packed.faces.ravel().astype(np.int64)
        elif "indices" in primitive:
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
        attributes: dict[str, Any],
        coordinates: int | None,
        targets: dict[str, Any],
        placed: _Placed,
        look: _Material,
        packed: Any,
    ) -> slice:
        file, linear = self.file, placed.place[:3, :3].T

        def read(attribute: str, index: int, width: int) -> Array:
            return file.accessor(index, width, unpacked=_packed_values(file, packed, attribute))

        points = read("POSITION", attributes["POSITION"], 3).astype(np.float64)
        span = slice(self.count, self.count + len(points))
        check_counts(str(file.path), vertices=span.stop, faces=1, shapes=max(len(targets), 1))
        self.positions.append(points @ linear + placed.place[:3, 3])
        uv: Float64Array | None = None
        if coordinates is not None:
            uv = read(look.uv, coordinates, 2).astype(np.float64)
            if len(uv) != len(points):
                raise CaptureError(
                    f"{file.path}: {len(points)} positions and {len(uv)} texture coordinates"
                )
            uv = uv @ look.transform[:2] + look.transform[2]
        self.uv.append(uv)
        self.count = span.stop
        for number, (name, index) in enumerate(targets.items()):
            if index is None:
                continue
            delta = file.accessor(index, 3).astype(np.float32)
            if len(delta) != len(points):
                raise CaptureError(
                    f"{file.path}: morph target {name!r} has {len(delta)} vertices, its mesh "
                    f"{len(points)}"
                )
            moved = (delta @ linear).astype(np.float32)
            self.targets.append(
                _Target(span=span, name=name, delta=moved, placed=placed, number=number)
            )
        return span


def _unpack(file: GltfFile, primitive: dict[str, Any]) -> Any:
    """The mesh that Draco packed, or None."""
    _, entry = file.extension(primitive, DRACO)
    if not entry:
        return None
    try:
        import DracoPy
    except ImportError:
        raise missing_wheel(str(file.path), DRACO) from None
    try:
        mesh = DracoPy.decode(bytes(file.view(file.number(entry, "bufferView"))[0]))
        mesh.ids = entry["attributes"]
        return mesh if len(mesh.faces) else None
    except (DracoPy.FileTypeException, ValueError, AttributeError, KeyError, TypeError) as error:
        raise CaptureError(f"{file.path}: a mesh cannot be unpacked by Draco ({error})") from error


def _packed_values(file: GltfFile, packed: Any, attribute: str) -> Array | None:
    if packed is None or not isinstance(packed.ids, dict) or attribute not in packed.ids:
        return None
    found = packed.get_attribute_by_unique_id(packed.ids[attribute])
    if found is None:
        raise CaptureError(f"{file.path}: Draco's data has no attribute {attribute}")
    values: Array = found["data"]
    return values


def _expressions(file: GltfFile, targets: list[_Target]) -> dict[str, list[tuple[_Target, float]]]:
    """The expressions of VRM: what each adds up of morph targets; 0.x counts in hundredths."""
    version, vrm = file.extension(file.root, *VRM)
    found: list[tuple[Any, Any, str, float]] = []
    if version == "VRM":
        groups = file.entries(child(vrm, "blendShapeMaster"), "blendShapeGroups")
        for group in filter(_is_object, groups):
            preset = group.get("presetName")
            name = preset if preset not in ("", "unknown", None) else group.get("name")
            found.append((name, group.get("binds"), "mesh", 0.01))
    elif version:
        for part in ("preset", "custom"):
            some = child(child(vrm, "expressions"), part)
            for name in some:
                found.append((name, child(some, name).get("morphTargetBinds"), "node", 1.0))
    result: dict[str, list[tuple[_Target, float]]] = {}
    for name, binds, owner, scale in found:
        for bind in filter(_is_object, binds if isinstance(binds, list) else ()):
            weight = bind.get("weight", 1 / scale)
            place = bind.get(owner), bind.get("index")
            for target in targets:
                if _is_real(weight) and place == (getattr(target.placed, owner), target.number):
                    result.setdefault(str(name), []).append((target, weight * scale))
    return result


def _is_object(value: Any) -> bool:
    return isinstance(value, dict)


def read_glb(path: Path) -> RigSource:
    """Read a rig from a .glb, .vrm or .gltf file."""
    with np.errstate(all="ignore"):  # what is not finite is found by `check_source`
        return check_source(_read(GltfFile(path)))


def _read(file: GltfFile) -> RigSource:
    path = file.path
    builder = _Builder(file)
    for placed in _placed_meshes(file):
        mesh = file.item("meshes", placed.mesh)
        for primitive in file.entries(mesh, "primitives"):
            if not isinstance(primitive, dict):
                raise CaptureError(f"{path}: meshes {placed.mesh}: a primitive is no object")
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
        copyright=str(child(file.root, "asset").get("copyright", ""))[:500],
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
