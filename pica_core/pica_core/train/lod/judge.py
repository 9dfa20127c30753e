"""What people look at, what can be seen, and what pokes through: where triangles are to be spent.

A file says nothing of regions, so they are found by what moves: eyes are what eye movements move
most, a mouth what mouth movements do. A pixel pokes through if it shows another piece of the mesh
(an eyeball, teeth) than the full level shows within a pixel.
"""

from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor

from pica_core.avatar.arkit import ARKIT_NAMES, NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.capture.face_errors import poking
from pica_core.capture.stage.dome import NAMED_VIEWS, dome_cameras
from pica_core.capture.triangles import components, nearest
from pica_core.train.lod.exits import FaceSet
from pica_core.train.lod.simplify import weld
from pica_core.train.raster import Rasteriser
from pica_core.types import Array, BoolArray, ByteArray, FloatArray, IntArray

LEAST_SHARE = 0.3
"""A vertex belongs to eyes or mouth if it moves by so much of what the most moved one does."""

POKE_VIEWS = ("front", "left", "right")
IMAGE_SIZE = 384
"""Rows of a picture; heads are about 350 high."""
POKE_REACH_M = 0.006
"""How far around a pixel that pokes through vertices are taken to be at fault (chosen: the distance
of vertices of a collar)."""

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
                ids = raster.triangle_ids(shape, camera)
                seen[faces[np.unique(ids[ids >= 0])]] = True
    for _ in range(SEEN_RINGS):
        seen[faces[seen[faces].any(1)]] = True
    return seen


class PokeFinder:
    """Says where a coarser mesh lets one piece of a mesh show through another, and which vertices
    are at fault.

    Args:
        shapes_m: The mesh at rest, then in other faces, metres, ``[K, V, 3]``.
        faces: Its triangles, int32 ``[F, 3]``.
    """

    def __init__(self, shapes_m: Array, faces: Array) -> None:
        self._shapes_m = np.ascontiguousarray(shapes_m, np.float32)
        self._faces, self._piece = faces, _pieces(shapes_m[0], faces)
        self._truth = list(self._draw(faces))

    def find(self, mesh: Array) -> tuple[float, BoolArray]:
        """Compare a mesh of the same vertices, int32 ``[F', 3]``, with the full one.

        Returns:
            The largest ratio of a head's pixels that poke through in a picture; and the vertices
            within `POKE_REACH_M` of such a pixel, of the piece that shows and of the one that
            should, bool ``[V]``.
        """
        most, near = 0.0, np.zeros(len(self._piece), bool)
        for (shape_m, ids), (_, true_ids) in zip(self._draw(mesh), self._truth, strict=True):
            shown = _pieces_of(self._piece, mesh, ids)
            truth = _pieces_of(self._piece, self._faces, true_ids)
            where = poking(shown, truth)
            if where.any():
                most = max(most, float(where.sum() / (truth > 0).sum()))
                pixel, apart_m = nearest(shape_m, shape_m[self._faces[true_ids[where]]].mean(1))
                at_fault = (self._piece == shown[where][pixel]) | (
                    self._piece == truth[where][pixel]
                )
                near |= at_fault & (apart_m <= POKE_REACH_M)
        return most, near

    def _draw(self, mesh: Array) -> Iterator[tuple[FloatArray, IntArray]]:
        around = dome_cameras(5, IMAGE_SIZE, IMAGE_SIZE)
        cameras = [camera for camera in around if camera.name in POKE_VIEWS]
        with Rasteriser(mesh.astype(np.int32), len(self._piece)) as raster:
            for shape_m in self._shapes_m:
                for camera in cameras:
                    yield shape_m, raster.triangle_ids(shape_m, camera)


def _pieces_of(piece: Array, faces: Array, ids: IntArray) -> ByteArray:
    """The piece of the triangle that each pixel shows, 0 where none is."""
    return np.where(ids < 0, 0, piece[faces[np.maximum(ids, 0), 0]]).astype(np.uint8)


def _tensor(latents: Array) -> Tensor:
    grid = torch.from_numpy(np.asarray(latents, np.float32))
    return grid.permute(0, 3, 1, 2).contiguous()


def _pieces(vertices_m: Array, faces: Array) -> Array:
    """Which connected piece each vertex is of, from 1, the largest ones; 255 of all others."""
    first = weld(vertices_m)
    label = components(first[faces], len(first))[first]
    names, count = np.unique(label, return_counts=True)
    number = np.full(len(vertices_m), 255)
    for place, name in enumerate(names[np.argsort(-count, kind="stable")][:254]):
        number[label == name] = place + 1
    return number
