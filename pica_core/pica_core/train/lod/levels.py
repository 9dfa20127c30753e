"""Give an avatar levels of detail, from what its file holds.

No capture and no checkpoint is needed: the decoders are rebuilt from the tensors, and the faces to
fit on are performances of the stage's generators as the avatar's own expression encoder codes them,
with noise, seen from all over the front. Nothing of the full model changes.

    levelled = add_levels(avatar)
"""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import EXIT_SIZES, PREFIX, STILL_NAME, faces_name
from pica_core.avatar.linear import components_of, weights_of_latent
from pica_core.capture.stage.expressions import stream_training_performances
from pica_core.capture.triangles import areas, signed_areas
from pica_core.model.decoders import sample_map
from pica_core.reference.decoders import FRONT
from pica_core.train.lod.exits import (
    FaceSet,
    FrozenDecoder,
    MapExit,
    colour_metric,
    fit_convolution,
    fit_local,
)
from pica_core.train.lod.simplify import Simplifier
from pica_core.train.lod.surface import (
    looked_at,
    mark_static,
    seen_vertices,
)
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
        if (
            level == EXIT_SIZES[0]
        ):  # finer ones leave little, and their weights are four times as many
            fitted = fit_local(full.decoder, faces, level, fitted)
        tensors |= _exit_tensors(level, fitted) | {faces_name(level): mesh}
    show("static surfaces")
    return mark_static(Avatar(avatar.manifest, tensors))


def _draw_faces(avatar: Avatar) -> FaceSet:
    """Draw faces to fit on."""
    rng = np.random.default_rng([0, 0])
    seed = int(rng.integers(2**31))
    arkit = np.concatenate(stream_training_performances(ROUNDS, seed=seed))
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
