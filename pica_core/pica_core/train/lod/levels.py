"""Give an avatar levels of detail, from what its file holds.

No capture and no checkpoint is needed: the decoders are rebuilt from the tensors, and the faces to
fit on are performances of the stage's generators as the avatar's own expression encoder codes them,
with noise, seen from all over the front. Nothing of the full model changes.

    levelled = add_levels(avatar)
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import (
    PREFIX,
    STILL_NAME,
    faces_name,
    level_sizes,
    sheet_rows,
)
from pica_core.avatar.linear import components_of, weights_of_latent
from pica_core.capture.stage.expressions import stream_training_performances
from pica_core.capture.triangles import areas, signed_areas
from pica_core.model.decoders import sample_map
from pica_core.reference.decoders import FRONT
from pica_core.train.lod.exits import (
    FaceSet,
    FrozenDecoder,
    MapExit,
    SheetExit,
    colour_metric,
    fit_convolution,
    fit_local,
    fit_sheet,
)
from pica_core.train.lod.judge import (
    PokeFinder,
    looked_at,
    seen_vertices,
)
from pica_core.train.lod.simplify import Simplifier
from pica_core.train.lod.static import mark_static
from pica_core.types import Array

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
MENDINGS = 3
"""How often meshes are made again because one piece pokes through another."""
GOOD_POKE = 1e-4
"""Ratio of a picture's pixels that may poke through before a mesh is made again."""
MENDED = (4.0, 300.0)
"""How many times more errors count each time where something pokes through, and at most."""
POKE_SHAPES = 24
"""Faces in which meshes are looked at for what pokes through."""
UNSEEN = 0.1
"""How much errors of a mesh count where no view sees it: triangles are spent where they show (with
a fiftieth, necks poke through collars: docs/architecture.md)."""
STRONG_SHAPES = 8
"""Faces far from rest in which a mesh is to keep its looks."""
METRIC_FACES = 6
"""Faces that the slope of the pixel decoder is averaged over."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LevelOptions:
    """How much it takes to make levels."""

    faces: int = 320
    """Faces to fit on."""
    rounds: int = 12
    """Performances of each kind to draw them from."""
    points: int = 24_000
    """Points of the surface at which colours are compared."""
    bias_points: int = 200_000
    """Points at which the bias of a map is fitted: 12 for each texel of 128 (with 24,000, as many
    as colours are compared at, single texels went wrong and showed as specks)."""
    mesh_ratios: tuple[float, ...] = (0.22, 0.35)
    """Triangles of the levels' meshes, the coarsest first, as shares of the full mesh (chosen: with
    0.16 nostrils of people tear at heads 300 pixels high: docs/architecture.md)."""
    texels: tuple[int, ...] = (2, 1)
    """Texels of the trunk per vertex, the coarsest level first (chosen: at 64, which weak machines
    draw most of the time, one leaves 0.063 mm and two 0.042, and half of what pokes out; at 128 one
    leaves 0.076 and two 0.046, but both would not fit into a file of 4 MB)."""


def add_levels(
    avatar: Avatar,
    options: LevelOptions | None = None,
    show: Callable[[str], None] = lambda _: None,
) -> Avatar:
    """Fit exits and simplify meshes for every level below the full one: the avatar with its levels
    and its static surface marked."""
    options = options or LevelOptions()
    tensors = dict(avatar.tensors)
    faces = _draw_faces(avatar, options)
    full = _FullLevel(avatar, faces, options)
    show("meshes")
    levels = level_sizes(avatar.spec)[:-1]
    mean_face = FaceSet(faces.latents.mean(dim=0, keepdim=True), torch.tensor([FRONT]))
    ((_, (still,)),) = full.decoders["expression"].run(mean_face, levels[0])
    tensors[STILL_NAME] = mean_face.latents[0].permute(1, 2, 0).numpy().copy()
    regions = looked_at(avatar, full.vertices_m)
    meshes = _simplify(full, regions, options)[-len(levels) :]
    for level, mesh, texels in zip(levels, meshes, options.texels[-len(levels) :], strict=True):
        show(f"level {level}: {len(mesh)} triangles; exits")
        geometry = None  # bases need no exit: they make a level's vertices as they are
        if "geometry" in full.decoders:
            rest = full.mean_map / avatar.manifest.position_scale_m
            vertex_uv = full.vertex_uv[np.unique(mesh)]
            geometry = fit_sheet(full.decoders["geometry"], faces, level, vertex_uv, rest, texels)
        expression = fit_convolution(
            full.decoders["expression"],
            faces,
            level,
            full.points,
            full.metric,
            full.bias_points,
            still,
        )
        if level == levels[0]:  # finer ones leave little, and their weights are four times as many
            expression = fit_local(full.decoders["expression"], faces, level, expression)
        tensors |= _exit_tensors(avatar, level, geometry, expression) | {faces_name(level): mesh}
    show("static surfaces")
    return mark_static(Avatar(avatar.manifest, tensors))


def _draw_faces(avatar: Avatar, options: LevelOptions) -> FaceSet:
    """Draw faces to fit on."""
    rng = np.random.default_rng([0, 0])
    seed = int(rng.integers(2**31))
    arkit = np.concatenate(stream_training_performances(options.rounds, seed=seed))
    shown = arkit[:, [ARKIT_NAMES.index(name) for name in MORE_OF]].max(axis=1)
    chance = LEAST_CHANCE + np.clip(shown, 0, 1)
    count, chance = options.faces, chance / chance.sum()
    chosen = rng.choice(len(arkit), count, replace=len(arkit) < count, p=chance)
    codes = ExpressionEncoder(avatar).encode(arkit[chosen])
    codes = codes + NOISE_RATIO * codes.std(axis=0) * rng.standard_normal(codes.shape)
    views = rng.standard_normal((count, 3))
    views[:, 2] = np.abs(views[:, 2])
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    return FaceSet(
        torch.from_numpy(codes.astype(np.float32)).permute(0, 3, 1, 2).contiguous(),
        torch.from_numpy(views.astype(np.float32)),
    )


class _FullLevel:
    """The full model, rebuilt from its file, and what is known of its surface over the faces.

    Attributes:
        vertex_uv: ``[V, 2]``.
        moving_vertices_m: Vertices at rest, and in some faces far from it and from each other, the
            farthest first, ``[K, V, 3]``.
        points: Points of the surface, UV, ``[P, 2]``: half of them spread over the area of the mesh
            at rest, half over the area of its UVs, which give mouth and eyes more room.
        xyz_m: Where the points are at rest, ``[P, 3]``.
        bias_points: More such points, UV, ``[B, 2]``.
        metric: See `colour_metric`; float32.
    """

    def __init__(self, avatar: Avatar, faces: FaceSet, options: LevelOptions) -> None:
        tensors = avatar.tensors
        self.avatar = avatar
        self.decoders = {name: FrozenDecoder(avatar, name) for name in avatar.spec.decoder_channels}
        self.vertex_uv = torch.from_numpy(np.array(tensors["mesh.vertex_uv"]))
        self._level = level_sizes(avatar.spec)[0]
        shapes = self.vertices_m(faces)
        # The mean map, not the mean of what is decoded: only there both sides of a seam meet.
        rest = avatar.mean_vertices_m
        self.moving_vertices_m = np.concatenate([rest[None], _far_apart(shapes, POKE_SHAPES)])
        rng = np.random.default_rng(0)
        mesh = rest, tensors["mesh.vertex_uv"], tensors["mesh.faces"]
        self.points, self.xyz_m = _scatter(*mesh, options.points, rng)
        some = rng.choice(len(faces), METRIC_FACES, replace=False)
        chosen = FaceSet(faces.latents[some], faces.views[some])
        codes = torch.cat(
            [
                sample_map(full, self.points)
                for _, full in self.decoders["expression"].run(chosen, self._level)
            ]
        )
        metric = colour_metric(
            avatar, list(codes.double().numpy()), self.xyz_m, self.points.double().numpy()
        )
        self.metric = torch.from_numpy(metric.astype(np.float32))
        self.bias_points, _ = _scatter(*mesh, options.bias_points, rng)

    @property
    def mean_map(self) -> Tensor:
        """The mean map, metres, ``[3, S, S]``."""
        return torch.from_numpy(np.array(self.avatar.tensors["geometry.mean"])).permute(2, 0, 1)

    def vertices_m(self, faces: FaceSet, vertices: Array | None = None) -> Array:
        """Vertices of faces, all or some by their numbers, metres, ``[N, V, 3]``."""
        tensors, scale = self.avatar.tensors, self.avatar.manifest.position_scale_m
        chosen = np.arange(len(self.vertex_uv)) if vertices is None else vertices
        if "geometry" in self.decoders:
            runs = self.decoders["geometry"].run(faces, self._level)
            maps = (self.mean_map + scale * full for _, full in runs)
            uv = self.vertex_uv[chosen]
            decoded: Array = torch.cat([sample_map(each, uv) for each in maps]).numpy()
            return decoded
        weights = weights_of_latent(tensors, faces.latents.permute(0, 2, 3, 1).numpy())
        components = components_of(tensors, scale, chosen.astype(np.int32))
        moved = np.tensordot(weights.astype(np.float32), components, axes=1)
        return np.asarray(self.avatar.mean_vertices_m[chosen] + moved)


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


def _simplify(level: _FullLevel, regions: tuple[Array, ...], options: LevelOptions) -> list[Array]:
    """A mesh for each level, the coarsest first; each uses vertices of the next finer one.

    Where something pokes through the coarsest one, errors count more, and all are made again; those
    stay through which least pokes.
    """
    avatar, shapes_m = level.avatar, level.moving_vertices_m[: 1 + STRONG_SHAPES]
    full, uv = (np.array(avatar.tensors[f"mesh.{name}"]) for name in ("faces", "vertex_uv"))
    importance = 1 + (np.array(IMPORTANCE) - 1) @ np.stack(regions)
    importance[~seen_vertices(shapes_m, full)] *= UNSEEN
    pokes = PokeFinder(level.moving_vertices_m, full)
    map_size = None if avatar.spec.geometry == "bases" else avatar.spec.map_size
    least, found = np.inf, list[Array]()
    for _ in range(1 + MENDINGS):
        mesh, meshes = Simplifier(shapes_m, uv, full, importance), list[Array]()
        for ratio in reversed(options.mesh_ratios):
            mesh.reduce(round(ratio * len(full)), map_size)
            meshes.insert(0, mesh.faces())
        most, near = pokes.find(meshes[0])
        if most < least:
            least, found = most, meshes
        if most <= GOOD_POKE:
            break
        more = np.minimum(np.maximum(importance, 1) * MENDED[0], MENDED[1])
        importance = np.where(near, more, importance)
    return found


def _exit_tensors(
    avatar: Avatar, level: int, geometry: SheetExit | None, expression: MapExit
) -> dict[str, Array]:
    exits = {"expression.weight": expression.weight, "expression.bias": expression.bias}
    if expression.local is not None:
        exits["expression.local"] = expression.local.flatten(2)
    if geometry is not None:
        num_slots = level * sheet_rows(len(geometry.rest), level)

        def sheet(values: Tensor) -> Tensor:
            filled = torch.zeros(num_slots, values[0].numel(), dtype=values.dtype)
            filled[: len(values)] = values.flatten(1)
            return filled.reshape(-1, level, filled.shape[1])

        mean_m = geometry.rest * avatar.manifest.position_scale_m
        # Slots without a vertex repeat one: numbers far from the others would cost the
        # rounding of all.
        mean_m = torch.cat([mean_m, mean_m[-1:].expand(num_slots - len(mean_m), -1)])
        exits["geometry.weight"] = sheet(geometry.weight)
        exits["geometry.mean"] = sheet(mean_m)
        exits["geometry.texel"] = sheet(geometry.texel).int()
    return {f"{PREFIX}{level}.{name}": values.numpy().copy() for name, values in exits.items()}
