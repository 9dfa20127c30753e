"""Give an avatar levels of detail, from what its file holds.

No capture and no checkpoint is needed: the decoders are rebuilt from the tensors, and the faces to
fit on are performances of the stage's generators as the avatar's own expression encoder codes them,
with noise, seen from all over the front. Nothing of the full model changes.

    levelled = add_levels(avatar)

A file says nothing of regions, so they are found by what moves: eyes are what eye movements move
most, a mouth what mouth movements do. A vertex is static where neither its colour nor its place
leaves the still face's by more than the limits, over performances and random strong faces, each
seen from another side. Specks are evened out: static is what is so with all around it.
`pica_core.avatar.levels` says what the marks mean.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from pica_core.avatar.arkit import ARKIT_NAMES, NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import (
    EXIT_SIZES,
    MOVING,
    PREFIX,
    SEAM,
    STATIC,
    STATIC_NAME,
    STILL_NAME,
    faces_name,
    pack_parts,
)
from pica_core.avatar.linear import components_of, weights_of_latent
from pica_core.camera import NAMED_VIEWS, dome_cameras
from pica_core.capture.stage.expressions import combinations, sentence, stream_training_expressions
from pica_core.capture.triangles import areas, components, signed_areas
from pica_core.model.networks import sample_map
from pica_core.reference import (
    FRONT,
    decode_expression_map,
    decode_pixels,
    decode_position_map,
    still_colours,
)
from pica_core.sampling import sample_bilinear
from pica_core.train.lod.exits import (
    FaceSet,
    FrozenDecoder,
    MapExit,
    colour_metric,
    fit_convolution,
    fit_local,
)
from pica_core.train.lod.simplify import Simplifier, weld
from pica_core.train.raster import GLRasteriser, Views
from pica_core.types import Array, BoolArray, ByteArray, Float64Array

LEAST_SHARE = 0.3
"""A vertex belongs to eyes or mouth if it moves by so much of what the most moved one does."""

SEEN_SIZE = 768
"""Rows of the pictures that tell which vertices can be seen."""
SEEN_RINGS = 2
"""How many neighbours further a vertex counts as seen: the next shape shows them."""


def looked_at(avatar: Avatar, vertices_of: Callable[[FaceSet], Array]) -> tuple[Array, ...]:
    """Which vertices are eyes, and which mouth, bool ``[V]`` each, by the full level's vertices of
    faces, ``[N, V, 3]``."""
    names = np.array(ARKIT_NAMES)
    latents = _tensor(ExpressionEncoder(avatar).encode(np.eye(NUM_ARKIT, dtype=np.float32)))
    rest = _tensor(ExpressionEncoder(avatar).encode(np.zeros((1, NUM_ARKIT), np.float32)))
    still = vertices_of(FaceSet(rest, torch.zeros(1, 3)))
    moved = np.linalg.norm(vertices_of(FaceSet(latents, torch.zeros(NUM_ARKIT, 3))) - still, axis=2)
    share = []
    for start in ("eye", "mouth"):
        by = moved[np.char.startswith(names, start)].max(0)
        share.append(by / max(float(by.max()), 1e-9))
    eyes, mouth = share
    return (eyes >= LEAST_SHARE) & (eyes > mouth), (mouth >= LEAST_SHARE) & (mouth >= eyes)


def seen_vertices(shapes_m: Array, faces: Array) -> BoolArray:
    """Which vertices the stage's named views see, bool ``[V]``.

    The views reach beyond the viewer's orbit; backs of eyeballs and of teeth, and skin below hair
    or cloth, are seen from nowhere.

    Args:
        shapes_m: The mesh in several faces, metres, ``[K, V, 3]``.
        faces: int32 ``[F, 3]``.
    """
    seen = np.zeros(shapes_m.shape[1], bool)
    with GLRasteriser(faces.astype(np.int32), len(seen)) as raster:
        for shape in shapes_m:
            for camera in dome_cameras(len(NAMED_VIEWS), SEEN_SIZE, SEEN_SIZE):
                mesh_m = torch.from_numpy(shape)[None]
                ids = raster.triangles(mesh_m, Views.of([camera])).numpy()
                seen[faces[np.unique(ids[ids >= 0])]] = True
    for _ in range(SEEN_RINGS):
        seen[faces[seen[faces].any(1)]] = True
    return seen


def _tensor(latents: Array) -> Tensor:
    grid = torch.from_numpy(np.asarray(latents, np.float32))
    return grid.permute(0, 3, 1, 2).contiguous()


MOST_MSE = 12.0
"""Mean squared change of colour, 0-255, that a static vertex may have (chosen: what a
talking face changes by between two frames begins at 10; no other limit was compared)."""
MOST_MOVED_M = 5e-4
"""How far a static vertex may move (chosen: a pixel of a head 500 pixels high)."""
COMPARED_FACES = 24
"""Faces to compare; each takes a tenth of a second."""
MARGIN_M = 0.004
"""A vertex this near to one that is not static is not static either."""
LEAST_AREA_M2 = 4e-4
"""Smaller pieces of the static surface are decoded."""
SEAM_M = 0.008
"""How far the texture gives way to what is decoded (chosen: a triangle or two of the coarsest
mesh)."""


def mark_static(avatar: Avatar) -> Avatar:
    """The avatar with its static vertices marked; unmarked where there are none, or where it has no
    levels, and so no still face."""
    tensors = {name: array for name, array in avatar.tensors.items() if name != STATIC_NAME}
    bare = replace(avatar, tensors=tensors)
    if STILL_NAME not in tensors:
        return bare
    change, moved_m = changes(bare)
    is_static = (change < MOST_MSE) & (moved_m < MOST_MOVED_M)
    parts = divide(bare, is_static)
    if (parts == STATIC).any():
        tensors[STATIC_NAME] = pack_parts(parts)
    return replace(bare, tensors=tensors)


def changes(avatar: Avatar) -> tuple[Float64Array, Float64Array]:
    """How much vertices differ from the still face: the mean squared change of their colours over
    faces and views, 0-255, and the farthest that they move, metres. ``[V]`` each."""
    rng = np.random.default_rng(0)
    third = COMPARED_FACES // 3
    talk, strong = (make(rng, 40 * third)[::40] for make in (sentence, combinations))
    random = rng.random((COMPARED_FACES - 2 * third, NUM_ARKIT)) * (rng.random(NUM_ARKIT) < 0.25)
    faces = np.concatenate([talk, strong, random]).astype(np.float32)
    rest_m, uv = avatar.mean_vertices_m, avatar.tensors["mesh.vertex_uv"]
    before = still_colours(avatar, rest_m, uv)
    change, moved_m = np.zeros(len(uv)), np.zeros(len(uv))
    for latent in ExpressionEncoder(avatar).encode(faces):
        yaw, pitch = rng.uniform(-0.8, 0.8), rng.uniform(-0.4, 0.4)
        view = np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)
        vertices_m = avatar.vertices_of(decode_position_map(avatar, latent), avatar.levels[-1])
        codes = sample_bilinear(decode_expression_map(avatar, latent, view), uv)
        after = decode_pixels(avatar.spec, avatar.tensors, codes, vertices_m, uv).clip(0, 1)
        change += np.square(255 * (after - before)).mean(axis=1) / len(faces)
        moved_m = np.maximum(moved_m, np.linalg.norm(vertices_m - rest_m, axis=1))
    return change, moved_m


def divide(avatar: Avatar, is_static: BoolArray) -> ByteArray:
    """Divide an avatar's vertices ``[V]`` into parts, by which of them do not change."""
    rest_m = avatar.mean_vertices_m.astype(np.float64)
    faces = avatar.level_faces(avatar.levels[-1])
    is_static = _evened(rest_m, faces, is_static)
    moving = np.unique(faces[~is_static[faces].all(axis=1)])
    parts = np.where(is_static, STATIC, MOVING).astype(np.uint8)
    if len(moving):
        parts[is_static & (KDTree(rest_m[moving]).query(rest_m)[0] < SEAM_M)] = SEAM
    return parts


def _evened(rest_m: Float64Array, faces: Array, is_static: BoolArray) -> BoolArray:
    """Static vertices but for those near to others, and those in small pieces."""
    used = np.zeros(len(rest_m), np.bool_)
    used[np.unique(faces)] = True
    moving = rest_m[used & ~is_static]
    if len(moving):
        is_static = is_static & (KDTree(moving).query(rest_m)[0] > MARGIN_M)
    own = faces[is_static[faces].all(axis=1)]
    place = weld(rest_m)
    label = components(place[own], len(rest_m))[place]
    area = np.bincount(label[own[:, 0]], areas(rest_m, own), label.max() + 1)
    return is_static & (area[label] > LEAST_AREA_M2)


NOISE_RATIO = 0.1
"""Noise on a latent, as a share of its standard deviation over the faces: between the practised
faces lie others."""
MORE_OF = ("eyeBlinkLeft", "eyeBlinkRight", "jawOpen")
"""Faces are drawn the more often the more of these they show: rare, large, and looked at."""
LEAST_CHANCE = 0.2
"""Chance of a face that shows nothing of them, where the most has 1.2."""
IMPORTANCE = (80.0, 6.0)
"""How much errors of a mesh count at eyes and at a mouth, where they count 1 elsewhere (measured on
three heads: docs/architecture.md)."""
UNSEEN = 0.1
"""How much errors of a mesh count where no view sees it: triangles are spent where they show (with
a fiftieth, necks poke through collars: docs/architecture.md)."""
STRONG_SHAPES = 8
"""Faces far from rest in which a mesh is to keep its looks."""
METRIC_FACES = 6
"""Faces that the slope of the pixel decoder is averaged over."""


NUM_FACES = 320
"""Faces to fit on."""
ROUNDS = 12
"""Performances of each kind to draw them from."""
POINTS = 24_000
"""Points of the surface at which colours are compared."""
BIAS_POINTS = 200_000
"""Points at which the bias of a map is fitted: 12 for each texel of 128 (with 24,000, as many as
colours are compared at, single texels went wrong and showed as specks)."""
MESH_RATIOS = (0.22, 0.35)
"""Triangles of the levels' meshes, the coarsest first, as shares of the full mesh (chosen: with
0.16 nostrils of people tear at heads 300 pixels high: docs/architecture.md)."""


def add_levels(avatar: Avatar, show: Callable[[str], None] = lambda _: None) -> Avatar:
    """Fit exits and simplify meshes for every level below the full one: the avatar with its levels
    and its static surface marked; as it is where no bases make its vertices."""
    if avatar.spec.geometry != "bases":
        return avatar
    tensors = dict(avatar.tensors)
    faces = _draw_faces(avatar)
    full = _FullLevel(avatar, faces)
    show("meshes")
    mean_face = FaceSet(faces.latents.mean(dim=0, keepdim=True), torch.tensor([FRONT]))
    ((_, (still,)),) = full.decoder.run(mean_face, EXIT_SIZES[0])
    tensors[STILL_NAME] = mean_face.latents[0].permute(1, 2, 0).numpy().copy()
    for level, mesh in zip(EXIT_SIZES, _simplify(full), strict=True):
        show(f"level {level}: {len(mesh)} triangles; exit")
        fitted = fit_convolution(
            full.decoder, faces, level, full.points, full.metric, full.bias_points, still
        )
        if level == EXIT_SIZES[0]:  # finer ones leave little, and would have four times the weights
            fitted = fit_local(full.decoder, faces, level, fitted)
        tensors |= _exit_tensors(level, fitted) | {faces_name(level): mesh}
    show("static surfaces")
    return mark_static(Avatar(avatar.manifest, tensors))


def _draw_faces(avatar: Avatar) -> FaceSet:
    """Draw faces to fit on."""
    rng = np.random.default_rng([0, 0])
    seed = int(rng.integers(2**31))
    arkit = stream_training_expressions(ROUNDS, seed=seed)
    shown = arkit[:, [ARKIT_NAMES.index(name) for name in MORE_OF]].max(axis=1)
    chance = LEAST_CHANCE + np.clip(shown, 0, 1)
    chance /= chance.sum()
    chosen = rng.choice(len(arkit), NUM_FACES, replace=len(arkit) < NUM_FACES, p=chance)
    codes = ExpressionEncoder(avatar).encode(arkit[chosen])
    codes = codes + NOISE_RATIO * codes.std(axis=0) * rng.standard_normal(codes.shape)
    views = rng.standard_normal((NUM_FACES, 3))
    views[:, 2] = np.abs(views[:, 2])
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    return FaceSet(
        torch.from_numpy(codes.astype(np.float32)).permute(0, 3, 1, 2).contiguous(),
        torch.from_numpy(views.astype(np.float32)),
    )


class _FullLevel:
    """The full model, rebuilt from its file, and what is known of its surface over the faces.

    Attributes:
        shapes_m: Vertices at rest, and in some faces far from it and from each other,
            ``[K, V, 3]``.
        points: Points of the surface, UV, ``[P, 2]``: half of them spread over the area of the mesh
            at rest, half over the area of its UVs, which give mouth and eyes more room.
        bias_points: More such points, UV, ``[B, 2]``.
        metric: See `colour_metric`; float32.
    """

    def __init__(self, avatar: Avatar, faces: FaceSet) -> None:
        self.avatar, self.decoder = avatar, FrozenDecoder(avatar)
        rest, far = avatar.mean_vertices_m, _far_apart(self.vertices_m(faces), STRONG_SHAPES)
        self.shapes_m = np.concatenate([rest[None], far])
        rng = np.random.default_rng(0)
        mesh = rest, avatar.tensors["mesh.vertex_uv"], avatar.tensors["mesh.faces"]
        self.points, xyz_m = _scatter(*mesh, POINTS, rng)
        some = rng.choice(len(faces), METRIC_FACES, replace=False)
        runs = self.decoder.run(FaceSet(faces.latents[some], faces.views[some]), EXIT_SIZES[0])
        codes = torch.cat([sample_map(full, self.points) for _, full in runs])
        metric = colour_metric(
            avatar, list(codes.double().numpy()), xyz_m, self.points.double().numpy()
        )
        self.metric = torch.from_numpy(metric.astype(np.float32))
        self.bias_points, _ = _scatter(*mesh, BIAS_POINTS, rng)

    def vertices_m(self, faces: FaceSet) -> Array:
        """Vertices of faces, metres, ``[N, V, 3]``."""
        tensors, mean_m = self.avatar.tensors, self.avatar.mean_vertices_m
        weights = weights_of_latent(tensors, faces.latents.permute(0, 2, 3, 1).numpy())
        numbers = np.arange(len(mean_m), dtype=np.int32)
        components = components_of(tensors, self.avatar.manifest.position_scale_m, numbers)
        return np.asarray(mean_m + np.tensordot(weights.astype(np.float32), components, axes=1))


def _far_apart(shapes: Array, count: int) -> Array:
    """Choose some shapes of ``[N, V, 3]`` that differ most from each other."""
    rows = shapes.reshape(len(shapes), -1)
    chosen = [int(np.argmax(np.square(rows - rows.mean(axis=0)).sum(axis=1)))]
    distance = np.full(len(rows), np.inf)
    while len(chosen) < min(count, len(rows)):
        distance = np.minimum(distance, np.square(rows - rows[chosen[-1]]).sum(axis=1))
        chosen.append(int(np.argmax(distance)))
    return shapes[chosen]


def _scatter(
    vertices_m: Array, vertex_uv: Array, faces: Array, count: int, rng: np.random.Generator
) -> tuple[Tensor, Array]:
    """Random points of a mesh: their UVs ``[P, 2]`` and positions ``[P, 3]``."""
    corners, places = vertices_m[faces].astype(np.float64), vertex_uv[faces].astype(np.float64)
    area = areas(vertices_m.astype(np.float64), faces)
    uv_area = np.abs(signed_areas(vertex_uv.astype(np.float64), faces))
    chance = area / area.sum() + uv_area / uv_area.sum()
    chosen = rng.choice(len(faces), count, p=chance / chance.sum())
    share = rng.dirichlet(np.ones(3), count)[..., None]
    uv = (places[chosen] * share).sum(axis=1)
    xyz_m = (corners[chosen] * share).sum(axis=1)
    return torch.from_numpy(uv.astype(np.float32)), xyz_m


def _simplify(level: _FullLevel) -> list[Array]:
    """A mesh for each level, the coarsest first; each uses vertices of the next finer one."""
    avatar, shapes_m = level.avatar, level.shapes_m
    full, uv = (np.array(avatar.tensors[f"mesh.{name}"]) for name in ("faces", "vertex_uv"))
    regions = np.stack(looked_at(avatar, level.vertices_m))
    importance = 1 + (np.array(IMPORTANCE) - 1) @ regions
    importance[~seen_vertices(shapes_m, full)] *= UNSEEN
    mesh, meshes = Simplifier(shapes_m, uv, full, importance), list[Array]()
    for ratio in reversed(MESH_RATIOS):
        mesh.reduce(round(ratio * len(full)))
        meshes.insert(0, mesh.faces())
    return meshes


def _exit_tensors(level: int, fitted: MapExit) -> dict[str, Array]:
    tensors = {"weight": fitted.weight, "bias": fitted.bias}
    if fitted.local is not None:
        tensors["local"] = fitted.local.flatten(2)
    name = f"{PREFIX}{level}.expression"
    return {f"{name}.{part}": values.numpy().copy() for part, values in tensors.items()}
