"""Read a rig from glTF (.glb, .vrm, .gltf): every mesh of the scene with its morph targets.

Understood are lists of triangles, node transforms, skins in the pose of their nodes, default
weights, base or diffuse colours (images with their texture transforms, factors, vertex colours),
and materials that one sees through.

Brows, lashes and lace are cards: their triangles are cut along the edge of their picture, which is
opaque where there is something. A triangle that is opaque in part is divided into `PARTS` squared
ones, which are cut where opacity, linear between their corners, crosses the cutoff.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from struct import error as StructError
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from pica_core.capture.rig.source import (
    MAX_ELEMENTS,
    WIDTH,
    GltfFile,
    RigSource,
    check_counts,
    check_source,
    extension,
    opacity_at,
)
from pica_core.errors import CaptureError
from pica_core.types import (
    Array,
    BoolArray,
    ByteArray,
    Float64Array,
    FloatArray,
    Int64Array,
    IntArray,
)

PARTS = 4
"""Parts of a triangle's edge (chosen: a tenth of an eyelash card's height)."""
_GRID = [(i, j) for i in range(PARTS + 1) for j in range(PARTS + 1 - i)]
_POINTS = np.array([(i, j, PARTS - i - j) for i, j in _GRID]) / PARTS
_AT = {place: number for number, place in enumerate(_GRID)}
_PIECES = np.array(
    [(_AT[i, j], _AT[i + 1, j], _AT[i, j + 1]) for i, j in _GRID if i + j < PARTS]
    + [(_AT[i + 1, j], _AT[i + 1, j + 1], _AT[i, j + 1]) for i, j in _GRID if i + j < PARTS - 1]
)
_DIGITS = 6
"""Decimals of a corner's weights by which corners of neighbours are the same."""


def cut(
    faces: IntArray, opacity: Callable[[Int64Array, Float64Array], Float64Array], cutoff: float
) -> tuple[BoolArray, Int64Array, Float64Array, Int64Array]:
    """Cut triangles where they begin to be seen through.

    Args:
        faces: Triangles in vertices. ``[F, 3]``.
        opacity: Gives the opacity 0 to 1 of triangles ``[n]`` at barycentric points ``[k, 3]``,
            ``[n, k]``.
        cutoff: Opacity from which on a point is solid.

    Returns:
        Which triangles stay whole ``[F]``; and of the pieces of others: new vertices as three old
        ones and their weights ``[N, 3]``, and triangles in new vertices ``[P, 3]``.
    """
    solid = opacity(np.arange(len(faces)), _POINTS) - cutoff
    whole = np.all(solid >= 0, axis=1)
    mixed = np.flatnonzero(np.any(solid >= 0, axis=1) & ~whole)
    corners: list[Array] = []
    for piece in _PIECES:
        values = solid[mixed][:, piece]
        for inside in range(1, 8):
            chosen = np.flatnonzero(((values >= 0) @ [1, 2, 4]) == inside)
            polygon = _clip(
                values[chosen], _POINTS[piece], [bool(inside >> k & 1) for k in range(3)]
            )
            for one, other in pairwise(range(1, polygon.shape[1])):
                weights = polygon[:, [0, one, other]]
                at = np.broadcast_to(faces[mixed[chosen], None], weights.shape)
                corners.append(np.stack([at, weights], -1))
    if not corners:
        return whole, np.zeros((0, 3), np.int64), np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    rows = np.concatenate(corners).reshape(-1, 3, 2)
    rows[..., 1] = np.round(rows[..., 1], _DIGITS)
    rows[rows[..., 1] == 0] = 0  # so that both triangles of an edge name its points alike
    rows = np.take_along_axis(rows, np.argsort(rows[..., 0], axis=1, kind="stable")[..., None], 1)
    unique, pieces = np.unique(rows.reshape(-1, 6), axis=0, return_inverse=True)
    unique = unique.reshape(-1, 3, 2)
    weights = unique[..., 1] / unique[..., 1].sum(1, keepdims=True)
    return whole, unique[..., 0].astype(np.int64), weights, pieces.reshape(-1, 3)


def _clip(values: Float64Array, points: Float64Array, inside: list[bool]) -> Float64Array:
    """The solid part of one piece in many triangles, as barycentric points ``[n, 3 or 4, 3]``.

    `values` are the corners' opacities above the cutoff ``[n, 3]``, negative where not `inside`.
    """
    found = []
    for k in range(3):
        after = (k + 1) % 3
        if inside[k]:
            found.append(np.broadcast_to(points[k], (len(values), 3)))
        if inside[k] != inside[after]:
            share = (values[:, k] / (values[:, k] - values[:, after]))[:, None]
            found.append(points[k] + share * (points[after] - points[k]))
    return np.stack(found, 1)


TRIANGLES = 4
MAX_NODE_DEPTH = 64
MAX_NODES, MAX_JOINTS, MAX_PIECES = 10_000, 2_000, 2_000
"""Of a scene, of a skin, and primitives of all meshes (chosen: clothed bodies have hundreds)."""
CLEAR = 0.5
"""Where a blended material is less opaque than this, it hides nothing."""
MALFORMED = (
    AttributeError, IndexError, KeyError, OverflowError, RecursionError, StructError,
    TypeError, ValueError,
)  # fmt: skip
"""What entries raise that are missing or of another kind than they should be."""


WHITE: ByteArray = np.full((1, 1, 4), 255, np.uint8)
"""The picture of a material that has a colour alone."""


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
    turn = Rotation.from_quat(np.array(node.get("rotation", [0, 0, 0, 1]), np.float64)).as_matrix()
    result[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]), np.float64).reshape(3)
    result[:3, 3] = np.array(node.get("translation", [0, 0, 0]), np.float64).reshape(3)
    return result


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Placed:
    """A mesh of the scene.

    Attributes:
        places: Its node's transform ``[1, 4, 4]``, or those of its skin's joints ``[J, 4, 4]``.
        skin: Number of its skin, or None.
        weights: How far each morph target is open at rest.
    """

    mesh: dict[str, Any]
    places: Float64Array
    skin: int | None
    weights: tuple[float, ...]


def _placed_meshes(file: GltfFile) -> Iterator[_Placed]:
    """Every mesh of the scene."""
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
        if len(worlds) == MAX_NODES:
            raise CaptureError(f"{file.path}: more than {MAX_NODES:,} nodes")
        worlds[index] = parent @ _matrix(node)
        stack += [(k, worlds[index], depth + 1) for k in node.get("children", [])]
    joints = cache(partial(_joints, file, worlds))
    for index, place in worlds.items():
        node = file.item("nodes", index)
        if "mesh" not in node:
            continue
        mesh, skin = file.item("meshes", node["mesh"]), node.get("skin")
        # The own transform of a node with a skin counts for nothing.
        places = place[None] if skin is None else joints(skin)
        weights = tuple(map(float, node.get("weights", mesh.get("weights", []))))
        yield _Placed(mesh=mesh, places=places, skin=skin, weights=weights)


def _joints(file: GltfFile, worlds: dict[int, Float64Array], number: int) -> Float64Array:
    """Where a skin's joints move what is stored. ``[J, 4, 4]``."""
    skin = file.item("skins", number)
    if (count := len(skin["joints"])) > MAX_JOINTS:
        raise CaptureError(f"{file.path}: skin {number} has {count:,} joints; up to {MAX_JOINTS:,}")
    places = np.stack([worlds.get(joint, np.eye(4)) for joint in skin["joints"]])
    if "inverseBindMatrices" in skin:
        inverse = file.accessor(skin["inverseBindMatrices"], 16, MAX_JOINTS).astype(np.float64)
        places = places @ inverse.reshape(-1, 4, 4).swapaxes(1, 2)
    return places


def _target_names(
    file: GltfFile, mesh: dict[str, Any], primitive: dict[str, Any], count: int
) -> list[str]:
    for owner in (mesh, primitive):
        names = owner.get("extras", {}).get("targetNames", [])
        if count and len(names) == count:
            return [str(name) for name in names]
    targets = primitive.get("targets", [])
    names = [target.get("extras", {}).get("name") for target in targets]
    if all(isinstance(name, str) for name in names):
        return names
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
    image: ByteArray | None
    colour: Float64Array
    """Linear RGB that image and vertex colours are multiplied with. ``[3]``."""
    alpha: float
    """Opacity that the whole material has."""
    cutoff: float | None
    """Opacity from which on it hides what is behind; None: it hides everywhere."""


PLAIN = _Material(
    name="default", uv="TEXCOORD_0", transform=np.eye(3, 2), image=None, colour=np.ones(3),
    alpha=1.0, cutoff=None,
)  # fmt: skip
"""What a primitive without a material has."""


def _material(file: GltfFile, index: int) -> _Material:
    entry = file.item("materials", index)
    pbr = entry.get("pbrMetallicRoughness", {})
    gloss = extension(entry, "KHR_materials_pbrSpecularGlossiness")
    texture = pbr.get("baseColorTexture") or gloss.get("diffuseTexture") or {}
    move = extension(texture, "KHR_texture_transform")
    scale = np.diag(np.array(move.get("scale", [1.0, 1.0]), np.float64).reshape(2))
    turn = float(move.get("rotation", 0.0))
    sine, cosine = np.sin(turn), np.cos(turn)
    linear = scale @ np.array([[cosine, -sine], [sine, cosine]])
    offset = np.array(move.get("offset", [0.0, 0.0]), np.float64).reshape(1, 2)
    factor = pbr.get("baseColorFactor", gloss.get("diffuseFactor", [1.0] * 4))
    factor = np.array(factor, np.float64).reshape(4)
    mode, cutoff = str(entry.get("alphaMode")), float(entry.get("alphaCutoff", CLEAR))
    return _Material(
        name=str(entry.get("name", f"material {index}")),
        uv=f"TEXCOORD_{move.get('texCoord', texture.get('texCoord', 0))}",
        transform=np.concatenate([linear, offset]),
        image=_image(file, texture["index"]) if "index" in texture else None,
        colour=factor[:3],
        alpha=float(factor[3]),
        cutoff={"MASK": cutoff, "BLEND": CLEAR}.get(mode),
    )


def _image(file: GltfFile, index: Any) -> ByteArray:
    texture = file.item("textures", index)
    other = extension(texture, "EXT_texture_webp")
    number = other.get("source", texture.get("source"))
    if number is None:
        names = ", ".join(texture.get("extensions", {})) or "a source"
        raise CaptureError(f"{file.path}: a texture needs {names}, which is not read here")
    return file.image(number)


class _Builder:
    """Primitives of all meshes, put one after the other."""

    def __init__(self, file: GltfFile) -> None:
        self.file = file
        count = len(file.root.get("materials", []))
        self.materials = [*(_material(file, k) for k in range(count)), PLAIN]
        self.positions: list[Float64Array] = []
        self.uv: list[Float64Array] = []
        self.colours: list[Float64Array] = []
        self.faces: list[IntArray] = []
        self.material: list[IntArray] = []
        self.targets: deque[tuple[str, slice, FloatArray]] = deque()
        self.count = self.num_faces = 0
        self.shared: dict[tuple[Any, ...], slice] = {}

    def add(self, placed: _Placed, primitive: dict[str, Any]) -> None:
        """Add one primitive; primitives on the same vertices share them."""
        file = self.file
        mode = primitive.get("mode", TRIANGLES)
        if mode < TRIANGLES:  # points and lines
            return
        if mode > TRIANGLES:
            raise CaptureError(f"{file.path}: strips or fans of triangles; export lists of them")
        attributes = primitive["attributes"]
        number = primitive.get("material", len(self.materials) - 1)
        if not 0 <= number < len(self.materials):
            raise CaptureError(f"{file.path}: materials {number} does not exist")
        look = self.materials[number]
        targets = primitive.get("targets", [])
        names = _target_names(file, placed.mesh, primitive, len(targets))
        at = [target.get("POSITION") for target in targets]
        used = [attributes.get(name) for name in ("POSITION", look.uv, "COLOR_0", "JOINTS_0")]
        place = placed.places.tobytes() if placed.skin is None else placed.skin
        move = place, look.transform.tobytes(), look.colour.tobytes()
        key = (*used, *at, *move, placed.weights)
        if key not in self.shared:
            self.shared[key] = self._add_vertices(
                attributes, list(zip(names, at, strict=True)), placed, look
            )
        if look.image is None and ("COLOR_0" in attributes or (look.colour != 1).any()):
            self.materials[number] = replace(look, image=WHITE)
        span = self.shared[key]
        count = span.stop - span.start
        index = np.arange(count)
        if "indices" in primitive:
            index = file.accessor(primitive["indices"], 1, 3 * MAX_ELEMENTS)[:, 0].astype(np.int64)
        if not len(index) or len(index) % 3 or index.min() < 0 or index.max() >= count:
            raise CaptureError(
                f"{file.path}: indices {primitive.get('indices')}: {len(index)} indices up to "
                f"{index.max(initial=0)}; triangles of {count} vertices are needed"
            )
        faces = (index.reshape(-1, 3) + span.start).astype(np.int32)
        is_mirrored = np.median(np.linalg.det(placed.places[:, :3, :3])) < 0
        self.faces.append(faces[:, ::-1] if is_mirrored else faces)
        self.num_faces += len(faces)
        check_counts(str(file.path), vertices=self.count, faces=self.num_faces, shapes=1)
        self.material.append(np.full(len(faces), number, np.int32))

    def _add_vertices(
        self,
        attributes: dict[str, Any],
        targets: list[tuple[str, Any]],
        placed: _Placed,
        look: _Material,
    ) -> slice:
        file = self.file

        def same_count(what: str, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            if len(values) != len(points):
                raise CaptureError(f"{file.path}: {len(points)} vertices, {len(values)} {what}")
            return values

        points = file.accessor(attributes["POSITION"], 3).astype(np.float64)
        span = slice(self.count, self.count + len(points))
        check_counts(str(file.path), vertices=span.stop, faces=1, shapes=max(len(targets), 1))
        place = placed.places[0]
        if placed.skin is not None and "JOINTS_0" in attributes:
            joints = same_count("joints", file.accessor(attributes["JOINTS_0"], 4))
            shares = same_count("weights", file.accessor(attributes["WEIGHTS_0"], 4))
            shares = shares.astype(np.float64) / np.maximum(shares.sum(1, keepdims=True), 1e-9)
            place = sum(shares[:, k, None, None] * placed.places[joints[:, k]] for k in range(4))
        linear = place[..., :3, :3]
        points = np.einsum("...ij,...j->...i", linear, points) + place[..., :3, 3]
        uv = np.zeros((len(points), 2))  # what has none gets islands of its own
        if (at := attributes.get(look.uv)) is not None:
            uv = same_count("texture coordinates", file.accessor(at, 2).astype(np.float64))
            uv = uv @ look.transform[:2] + look.transform[2]
        self.uv.append(uv)
        colours = np.tile(look.colour, (len(points), 1))
        if (at := attributes.get("COLOR_0")) is not None:
            width = WIDTH[file.item("accessors", at)["type"]]
            colours *= same_count("vertex colours", file.accessor(at, width))[:, :3]
        self.colours.append(colours)
        self.count = span.stop
        for number, (name, index) in enumerate(targets):
            if index is not None:
                delta = same_count(f"in morph target {name!r}", file.accessor(index, 3))
                moved = np.einsum("...ij,...j->...i", linear, delta.astype(np.float32))
                self.targets.append((name, span, moved.astype(np.float32)))
                if number < len(placed.weights):
                    points = points + placed.weights[number] * moved
        self.positions.append(points)
        return span


def _read(file: GltfFile) -> RigSource:
    path = file.path
    builder = _Builder(file)
    pieces = ((each, part) for each in _placed_meshes(file) for part in each.mesh["primitives"])
    for number, (placed, primitive) in enumerate(pieces, 1):
        if number > MAX_PIECES:
            raise CaptureError(f"{path}: more than {MAX_PIECES:,} primitives")
        builder.add(placed, primitive)
    if not builder.faces:
        raise CaptureError(f"{path}: no triangles")
    num_shapes = len({name for name, _, _ in builder.targets})
    check_counts(str(path), vertices=builder.count, faces=builder.num_faces, shapes=num_shapes)
    shapes: dict[str, FloatArray] = {}
    while builder.targets:  # which are let go, one after the other
        name, span, delta = builder.targets.popleft()
        shapes.setdefault(name, np.zeros((builder.count, 3), np.float32))[span] += delta
    material = np.concatenate(builder.material)
    names = [look.name for look in builder.materials]
    if material.max() < len(names) - 1:
        names.pop()  # PLAIN is not needed
    source = RigSource(
        path=path,
        positions=np.concatenate(builder.positions),
        faces=np.concatenate(builder.faces),
        uv=np.concatenate(builder.uv),
        materials=tuple(names),
        face_material=material,
        shapes=shapes,
        copyright=str(file.root.get("asset", {}).get("copyright", ""))[:500],
        images={k: m.image for k, m in enumerate(builder.materials) if m.image is not None},
        colours=np.concatenate(builder.colours).astype(np.float32),
        smaller_images=tuple(file.smaller_images),
    )
    for index, look in enumerate(builder.materials):
        if look.cutoff is not None and (source.face_material == index).any():
            source = _cut(source, index, look.alpha, look.cutoff)
    return source


def _cut(source: RigSource, index: int, alpha: float, cutoff: float) -> RigSource:
    """Leave of a material what hides what is behind: of lenses nothing, of cards their picture."""
    mine = np.flatnonzero(source.face_material == index)
    faces, image, uv = source.faces[mine], source.images.get(index), source.uv

    def opacity(chosen: Int64Array, points: Float64Array) -> Float64Array:
        if image is None:
            return np.full((len(chosen), len(points)), alpha)
        return alpha * opacity_at(image, np.einsum("kc,ncd->nkd", points, uv[faces[chosen]]))

    whole, at, weights, pieces = cut(faces, opacity, cutoff)

    def grown(values: Array) -> Array:
        more = np.einsum("nc,ncd->nd", weights, values[at])
        return np.concatenate([values, more.astype(values.dtype)])

    keep = np.ones(len(source.faces), np.bool_)
    keep[mine[~whole]] = False
    vertices, kept = len(source.positions) + len(at), int(keep.sum()) + len(pieces)
    check_counts(str(source.path), vertices=vertices, faces=kept, shapes=len(source.shapes))
    numbers = (pieces + len(source.positions)).astype(np.int32)
    return replace(
        source,
        positions=grown(source.positions),
        faces=np.concatenate([source.faces[keep], numbers]),
        uv=grown(uv),
        face_material=np.append(source.face_material[keep], np.full(len(pieces), index, np.int32)),
        shapes={name: grown(delta) for name, delta in source.shapes.items()},
        colours=grown(source.colours),
    )
