"""What of a surface is looked at, can be seen, or does not change with the face.

A file says nothing of regions, so they are found by what moves: eyes are what eye movements move
most, a mouth what mouth movements do.

A vertex is static where neither its colour nor its place leaves the still face's by more than the
limits, over performances and random strong faces, each seen from another side. Specks are evened
out: static is what is so with all around it. `pica_core.avatar.levels` says what the marks mean.
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
    MOVING,
    SEAM,
    STATIC,
    STATIC_NAME,
    STILL_NAME,
    pack_parts,
)
from pica_core.capture.stage.dome import NAMED_VIEWS, dome_cameras
from pica_core.capture.stage.expressions import combinations, sentence
from pica_core.capture.triangles import areas, components
from pica_core.reference.decoders import (
    decode_expression_map,
    decode_pixels,
    decode_position_map,
    still_colours,
)
from pica_core.sampling import sample_bilinear
from pica_core.train.lod.exits import FaceSet
from pica_core.train.raster import Rasteriser
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
    with Rasteriser(faces.astype(np.int32), len(seen)) as raster:
        for shape in shapes_m:
            for camera in dome_cameras(len(NAMED_VIEWS), SEEN_SIZE, SEEN_SIZE):
                ids = raster.triangle_ids(shape[None], [camera])[0]
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
NUM_FACES = 24
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
    third = NUM_FACES // 3
    talk, strong = (make(rng, 40 * third)[::40] for make in (sentence, combinations))
    random = rng.random((NUM_FACES - 2 * third, NUM_ARKIT)) * (rng.random(NUM_ARKIT) < 0.25)
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
    label = components(_places(rest_m)[own], len(rest_m))
    area = np.bincount(label[_places(rest_m)[own[:, 0]]], areas(rest_m, own), label.max() + 1)
    large: BoolArray = is_static & (area[label[_places(rest_m)]] > LEAST_AREA_M2)
    return large


def _places(rest_m: Float64Array) -> Array:
    """The first vertex in the place of each vertex, ``[V]``."""
    _, first, inverse = np.unique(
        np.rint(rest_m / 1e-5), axis=0, return_index=True, return_inverse=True
    )
    found: Array = first[inverse.reshape(-1)]
    return found
