"""Give an avatar levels of detail after the fact, from its file alone.

No capture and no checkpoint is needed: the decoders are rebuilt from the file, and the faces to fit
on are performances of the stage's generators as the avatar's own expression encoder codes them,
with noise, seen from all over the front. Nothing of the full model changes.

    levelled, report = add_levels(avatar, LevelOptions())
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pica_core.arkit import ARKIT_NAMES
from pica_core.avatar_file import Avatar
from pica_core.capture.practice import practice_performances
from pica_core.errors import TrainingOptionError
from pica_core.expression_encoder import ExpressionEncoder
from pica_core.level_tensors import PREFIX, faces_name
from pica_core.levels import level_sizes
from pica_core.model.decoders import sample_map
from pica_core.pixel_reference import decode_pixels
from pica_core.train.exits import (
    FaceSet,
    FrozenDecoder,
    Head,
    colour_metric,
    fit_convolution,
    fit_map,
    fit_texels,
)
from pica_core.train.simplify import Simplifier

Array = npt.NDArray[Any]

NOISE_RATIO = 0.1
"""Noise on a latent, as a share of its standard deviation over the faces: between the practised
faces lie others."""
MORE_OF = ("eyeBlinkLeft", "eyeBlinkRight", "jawOpen")
"""Faces are drawn the more often the more of these they show: rare, large, and looked at."""
LEAST_CHANCE = 0.2
"""Chance of a face that shows nothing of them, where the most has 1.2."""
METRIC_FACES = 6
"""Faces that the slope of the pixel decoder is averaged over."""
DROP_ROUNDS = 8
"""How often vertices that a map cannot hold are looked for and taken out."""
MISFIT_TEXELS_M = 0.064
"""Misfit of a vertex at rest that is too much, times the rows of the map: 1 mm at 64, 0.5 at 128.
A pixel of the largest head that these are drawn for is 2 mm and 1 mm."""
OTHER_VERTICES = 6000
"""Vertices of the full mesh that the finest exit is fitted to besides its own."""
OTHER_VERTEX_WEIGHT = 1e-2
"""Importance of a vertex that only the next finer mesh has: it is drawn while levels blend."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LevelOptions:
    """How levels are made."""

    faces: int = 320
    """Faces to fit on."""
    rounds: int = 12
    """Practice performances of each kind to draw them from."""
    points: int = 24_000
    """Points of the surface at which colours are compared."""
    triangles_ratio: float = 0.55
    """Triangles of a level's mesh per texel of its map; 64 x 64 texels carry 2,253."""
    check_faces: int = 48
    """Other faces, to report the error on."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("faces", 8, 100_000),
            ("rounds", 1, 1000),
            ("points", 100, 1_000_000),
            ("triangles_ratio", 0.01, 2.0),
            ("check_faces", 1, 10_000),
        ):
            if not low <= getattr(self, name) <= high:
                raise TrainingOptionError(
                    f"{name} is {getattr(self, name)}; {low} to {high} is allowed"
                )


@dataclass(frozen=True, kw_only=True, slots=True)
class LevelReport:
    """How far a level is from the full model, over faces that it was not fitted on."""

    level: int
    triangles: int
    vertices: int
    """Vertices that its mesh uses."""
    vertex_error_mm: float
    """Mean distance of the vertices of its mesh from the full level's."""
    vertex_error_p99_mm: float
    vertex_rest_mm: float
    """Mean distance of the full level's vertices from their own mean: the error of a still face."""
    colour_mse: float
    """Mean squared difference of colours at points of the surface, 0-255."""
    colour_still_mse: float
    """The same with an expression map that does not change."""


def add_levels(
    avatar: Avatar,
    options: LevelOptions | None = None,
    show: Callable[[str], None] = lambda _: None,
) -> tuple[Avatar, list[LevelReport]]:
    """Fit exits and simplify meshes for every level below the full one.

    Args:
        avatar: Checked avatar; levels that it has are made anew, a table of errors is dropped.
        options: See `LevelOptions`.
        show: Told what is being done.

    Returns:
        The avatar with its levels, and how good they are.
    """
    options = options or LevelOptions()
    tensors = {name: a for name, a in avatar.tensors.items() if not name.startswith(PREFIX)}
    bare = Avatar(avatar.manifest, tensors)
    faces, check = _draw_faces(bare, options)
    decoders = {name: FrozenDecoder(bare, name) for name in ("geometry", "expression")}
    surface = _Surface(bare, decoders, faces, options)
    show("meshes")
    levels = level_sizes(avatar.spec)[:-1]
    meshes = _simplify(bare, surface.moving_vertices_m, levels, options)
    reports = []
    finest = _some_vertices(tensors["mesh.vertex_uv"], options)
    for level, mesh, next_mesh in zip(levels, meshes, [*meshes[1:], finest], strict=True):
        finer = np.unique(next_mesh)
        show(f"level {level}: exits")
        heads = {
            "geometry": _fit_geometry(bare, decoders["geometry"], faces, level, mesh, finer),
            "expression": fit_convolution(
                decoders["expression"],
                faces,
                level,
                surface.points,
                surface.metric,
                seed=options.seed,
            ),
        }
        tensors |= _exit_tensors(avatar, level, heads) | {faces_name(level): mesh}
        show(f"level {level}: error")
        reports.append(_report(bare, decoders, heads, level, mesh, check, surface))
    return Avatar(avatar.manifest, tensors), reports


def _draw_faces(avatar: Avatar, options: LevelOptions) -> tuple[FaceSet, FaceSet]:
    """Faces to fit on and, from other performances, faces to judge by."""
    encoder = ExpressionEncoder(avatar)
    sets = []
    for number, (count, noise) in enumerate(
        ((options.faces, NOISE_RATIO), (options.check_faces, 0.0))
    ):
        rng = np.random.default_rng([options.seed, number])
        seed = int(rng.integers(2**31))
        arkit = np.concatenate(practice_performances(options.rounds, seed=seed))
        shown = arkit[:, [ARKIT_NAMES.index(name) for name in MORE_OF]].max(axis=1)
        chance = LEAST_CHANCE + np.clip(shown, 0, 1)
        chosen = rng.choice(len(arkit), count, replace=len(arkit) < count, p=chance / chance.sum())
        codes = encoder.encode(arkit[chosen])
        codes = codes + noise * codes.std(axis=0) * rng.standard_normal(codes.shape)
        views = rng.standard_normal((count, 3))
        views[:, 2] = np.abs(views[:, 2])
        views /= np.linalg.norm(views, axis=1, keepdims=True)
        sets.append(
            FaceSet(
                torch.from_numpy(codes.astype(np.float32)).permute(0, 3, 1, 2).contiguous(),
                torch.from_numpy(views.astype(np.float32)),
            )
        )
    return sets[0], sets[1]


class _Surface:
    """What is known of the full model's surface over the faces.

    Attributes:
        moving_vertices_m: Vertices at rest, and in some faces far from it, ``[K, V, 3]``.
        points: Points of the surface, UV, ``[P, 2]``: half of them spread over the area of the mesh
            at rest, half over the area of its UVs, which give mouth and eyes more room.
        xyz_m: Where the points are at rest, ``[P, 3]``.
        metric: See `colour_metric`; float32.
    """

    def __init__(
        self,
        avatar: Avatar,
        decoders: dict[str, FrozenDecoder],
        faces: FaceSet,
        options: LevelOptions,
    ) -> None:
        spec, tensors = avatar.spec, avatar.tensors
        vertex_uv = torch.from_numpy(np.array(tensors["mesh.vertex_uv"]))
        mean = torch.from_numpy(np.array(tensors["geometry.mean"])).permute(2, 0, 1)
        level = level_sizes(spec)[0]
        scale = avatar.manifest.position_scale_m
        shapes = torch.cat(
            [
                sample_map(mean + scale * full, vertex_uv)
                for _, full in decoders["geometry"].run(faces, level)
            ]
        ).numpy()
        # The mean map, not the mean of what is decoded: only there both sides of a seam meet.
        rest = sample_map(mean[None], vertex_uv)[0].numpy()
        self.moving_vertices_m = np.concatenate([rest[None], _far_apart(shapes)])
        rng = np.random.default_rng(options.seed)
        triangles = tensors["mesh.faces"]
        self.points, self.xyz_m = _scatter(
            rest, tensors["mesh.vertex_uv"], triangles, options.points, rng
        )
        some = rng.choice(len(faces), METRIC_FACES, replace=False)
        chosen = FaceSet(faces.latents[some], faces.views[some])
        codes = torch.cat(
            [sample_map(full, self.points) for _, full in decoders["expression"].run(chosen, level)]
        )
        metric = colour_metric(
            avatar, list(codes.double().numpy()), self.xyz_m, self.points.double().numpy()
        )
        self.metric = torch.from_numpy(metric.astype(np.float32))


def _far_apart(shapes: Array, count: int = 8) -> Array:
    """Of many shapes ``[N, V, 3]`` some that differ most from each other."""
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
    sides = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    across = places[:, 1:] - places[:, :1]
    uv_area = np.abs(across[:, 0, 0] * across[:, 1, 1] - across[:, 0, 1] * across[:, 1, 0])
    chance = area / area.sum() + uv_area / uv_area.sum()
    chosen = rng.choice(len(faces), count, p=chance / chance.sum())
    share = rng.dirichlet(np.ones(3), count)[..., None]
    uv = (places[chosen] * share).sum(axis=1)
    xyz_m = (corners[chosen] * share).sum(axis=1)
    return torch.from_numpy(uv.astype(np.float32)), xyz_m


def _simplify(
    avatar: Avatar, shapes_m: Array, levels: tuple[int, ...], options: LevelOptions
) -> list[Array]:
    """A mesh for each level; each uses vertices of the next finer one.

    Vertices that the level's map cannot hold, because charts or too many vertices share its texels,
    are taken out after the others.
    """
    vertex_uv = np.array(avatar.tensors["mesh.vertex_uv"])
    mean = torch.from_numpy(np.array(avatar.tensors["geometry.mean"])).permute(2, 0, 1)
    rest_m = sample_map(mean[None], torch.from_numpy(vertex_uv))[0]
    mesh = Simplifier(shapes_m, vertex_uv, avatar.tensors["mesh.faces"])
    meshes: list[Array] = []
    for level in reversed(levels):
        mesh.reduce(round(options.triangles_ratio * level * level), level)
        start = torch.nn.functional.adaptive_avg_pool2d(mean[None], level)[0]
        for _ in range(DROP_ROUNDS):
            used = np.unique(mesh.faces())
            points, wanted = (
                torch.from_numpy(vertex_uv[used]),
                rest_m[torch.from_numpy(used).long()],
            )
            held = fit_map(points, wanted, torch.ones(len(used)), start)
            misfit = (sample_map(held[None], points)[0] - wanted).norm(dim=1).numpy()
            worst = np.argsort(-misfit)[: int((misfit > MISFIT_TEXELS_M / level).sum())]
            # Every second one: its neighbour may fit when it has gone.
            if len(worst) == 0 or mesh.drop(used[worst[: (len(worst) + 1) // 2]]) == 0:
                break
        meshes.append(mesh.faces())
    return meshes[::-1]


def _some_vertices(vertex_uv: Array, options: LevelOptions) -> Array:
    """Vertices that stand for all of the full mesh."""
    rng = np.random.default_rng(options.seed)
    return rng.choice(len(vertex_uv), min(OTHER_VERTICES, len(vertex_uv)), replace=False)


def _fit_geometry(
    avatar: Avatar, decoder: FrozenDecoder, faces: FaceSet, level: int, mesh: Array, finer: Array
) -> Head:
    """Fit to the vertices of the level's mesh, and a little to those of a finer one."""
    own = np.unique(mesh)
    used = np.concatenate([own, np.setdiff1d(finer, own)])
    importance = torch.full((len(used),), OTHER_VERTEX_WEIGHT)
    importance[: len(own)] = 1.0
    mean = torch.from_numpy(np.array(avatar.tensors["geometry.mean"])).permute(2, 0, 1)
    return fit_texels(
        decoder,
        faces,
        level,
        torch.from_numpy(np.array(avatar.tensors["mesh.vertex_uv"][used])),
        importance,
        mean / avatar.manifest.position_scale_m,
    )


def _exit_tensors(avatar: Avatar, level: int, heads: dict[str, Head]) -> dict[str, Array]:
    geometry, expression = heads["geometry"], heads["expression"]
    mean = geometry.bias.permute(1, 2, 0) * avatar.manifest.position_scale_m
    found = {
        "geometry.weight": geometry.weight.permute(2, 3, 0, 1).flatten(2),
        "geometry.mean": mean,
        "expression.weight": expression.weight,
        "expression.bias": expression.bias,
    }
    return {
        f"{PREFIX}{level}.{name}": np.ascontiguousarray(values.numpy(), np.float32)
        for name, values in found.items()
    }


def _report(
    avatar: Avatar,
    decoders: dict[str, FrozenDecoder],
    heads: dict[str, Head],
    level: int,
    mesh: Array,
    check: FaceSet,
    surface: _Surface,
) -> LevelReport:
    used = np.unique(mesh)
    vertex_uv = torch.from_numpy(np.array(avatar.tensors["mesh.vertex_uv"][used]))
    mean = torch.from_numpy(np.array(avatar.tensors["geometry.mean"])).permute(2, 0, 1)
    scale = avatar.manifest.position_scale_m
    full, low = _lookups(decoders["geometry"], heads["geometry"], check, level, vertex_uv)
    full = full + sample_map(mean[None], vertex_uv) / scale
    distance = ((low - full) * scale * 1000).norm(dim=2)
    still = ((full - full.mean(0)) * scale * 1000).norm(dim=2)
    codes, low_codes = _lookups(
        decoders["expression"], heads["expression"], check, level, surface.points
    )

    def colours(values: Tensor) -> Array:
        shaded = [
            decode_pixels(
                avatar.spec,
                avatar.tensors,
                code,
                surface.xyz_m.astype(np.float32),
                surface.points.numpy(),
            )
            for code in values.numpy()
        ]
        clipped: Array = 255 * np.clip(np.stack(shaded), 0, 1)
        return clipped

    wanted = colours(codes)
    return LevelReport(
        level=level,
        triangles=len(mesh),
        vertices=len(used),
        vertex_error_mm=float(distance.mean()),
        vertex_error_p99_mm=float(distance.flatten().kthvalue(int(0.99 * distance.numel())).values),
        vertex_rest_mm=float(still.mean()),
        colour_mse=float(np.square(colours(low_codes) - wanted).mean()),
        colour_still_mse=float(np.square(colours(codes.mean(0, keepdim=True)) - wanted).mean()),
    )


def _lookups(
    decoder: FrozenDecoder, head: Head, faces: FaceSet, level: int, points: Tensor
) -> tuple[Tensor, Tensor]:
    """The decoder's own output and the head's at points, ``[N, P, C]`` each."""
    full, low = [], []
    for trunk, output in decoder.run(faces, level):
        full.append(sample_map(output, points))
        low.append(sample_map(head(trunk), points))
    return torch.cat(full), torch.cat(low)
