"""What may go wrong when a head of any mesh moves: folds, and eyeballs that poke out of the lids.

Pure numpy: no drawing. Metres in, millimetres inside.
"""

from __future__ import annotations

import numpy as np

from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.rig.features import Limits, find_features
from pica_core.capture.rig.guards import PoseGuard
from pica_core.capture.rig.mesh import RigMesh
from pica_core.capture.triangles import face_neighbours
from pica_core.types import BoolArray, Float64Array, Int64Array

SMALL_MM2 = 0.25
"""Smaller faces are left out: half a millimetre across, a pixel of a whole-head picture."""
CELL_MM = 2.0
ROW = 1 << 20
"""Cells in a row of the grid in which faces are listed: more than there ever are."""
POKE_MM = 0.15
"""How far an eyeball must stand out of the skin to count: about a pixel of a close camera."""


class MeshChecks:
    """Checks of one mesh in its welded form.

    Attributes:
        folded_at_rest: Which triangles of skin, hair and clothes over 0.25 mm² face against their
            neighbours at rest.
    """

    def __init__(self, mesh: RigMesh) -> None:
        features = find_features(mesh)
        skin, eye, *outer = (MATERIALS.index(name) for name in ("skin", "eye", "collar", "hair"))
        part, faces = features.part, mesh.faces.astype(np.int64)
        self._limits, self._guard = Limits(mesh, features), PoseGuard(mesh, features)
        self._rest, self._motion = mesh.rest_m, mesh.motion_m
        rest = 1000 * mesh.rest_m
        self.folded_at_rest = _folds(rest, faces[np.isin(part, [skin, *outer])])
        middle, eyes = rest[faces].mean(1), rest[np.unique(faces[part == eye])]
        before = middle[:, 2] > float(eyes[:, 2].mean()) + 2
        lids = (part == skin) & before & (np.abs(middle[:, 1] - float(eyes[:, 1].mean())) < 22)
        self._eyes, self._lids = faces[part == eye], faces[lids]

    def pose(self, arkit: Float64Array) -> Float64Array:
        """Vertices at the 52 shapes, millimetres ``[P, 3]``."""
        points = self._rest + np.tensordot(self._limits.apply(arkit), self._motion, 1)
        self._guard.apply(points)
        return 1000 * points

    def eyes_poking(self, arkit: Float64Array) -> int:
        """Places on eyeballs that stand out of the skin, from the front."""
        points = self.pose(arkit)
        places = np.concatenate([points[np.unique(self._eyes)], points[self._eyes].mean(1)])
        deep = front_depth(points, self._lids, places) - places[:, 2]
        return int(np.count_nonzero(deep < -POKE_MM))


def _folds(points: Float64Array, faces: Int64Array) -> BoolArray:
    order, start, pairs = face_neighbours(faces)
    a, b, c = (points[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    around = np.add.reduceat(normal[pairs], start, axis=0)
    normal = normal[order]
    size, length = np.linalg.norm(normal, axis=1), np.linalg.norm(around, axis=1)
    against: BoolArray = (normal * around).sum(1) < -0.3 * size * length
    return against & (0.5 * size > SMALL_MM2)


def front_depth(vertices: Float64Array, faces: Int64Array, points: Float64Array) -> Float64Array:
    """Depth z of the foremost face over each point, seen along -z; +inf where none covers it.

    Args:
        vertices: ``[V, 3]``.
        faces: ``[F, 3]``.
        points: ``[P, 3]``; z is not used.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    det = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    facing = det > 1e-6
    a, b, c, det = a[facing], b[facing], c[facing], det[facing]
    # Faces are listed in the square cells that they touch; a point meets those of its own cell.
    corner = points[:, :2].min(0) - CELL_MM
    low = np.floor((np.minimum(np.minimum(a, b), c)[:, :2] - corner) / CELL_MM).astype(np.int64)
    high = np.floor((np.maximum(np.maximum(a, b), c)[:, :2] - corner) / CELL_MM).astype(np.int64)
    span = high - low + 1
    count = span.prod(1)
    face = np.repeat(np.arange(len(a)), count)
    step = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    across = span[face, 0]
    cell = (low[face, 0] + step % across) + (low[face, 1] + step // across) * ROW
    order = np.argsort(cell, kind="stable")
    cell, face = cell[order], face[order]
    where = np.floor((points[:, :2] - corner) / CELL_MM).astype(np.int64)
    wanted = where[:, 0] + where[:, 1] * ROW
    start, stop = np.searchsorted(cell, wanted, "left"), np.searchsorted(cell, wanted, "right")
    number = stop - start
    point = np.repeat(np.arange(len(points)), number)
    listed = np.arange(len(point)) - np.repeat(np.cumsum(number) - number, number)
    met = face[np.repeat(start, number) + listed]
    x, y = points[point, 0], points[point, 1]
    p, q, r, d = a[met], b[met], c[met], det[met]
    v = ((x - p[:, 0]) * (r[:, 1] - p[:, 1]) - (r[:, 0] - p[:, 0]) * (y - p[:, 1])) / d
    w = ((q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (x - p[:, 0]) * (q[:, 1] - p[:, 1])) / d
    inside = (v >= 0) & (w >= 0) & (v + w <= 1)
    z = p[:, 2] + v * (q[:, 2] - p[:, 2]) + w * (r[:, 2] - p[:, 2])
    best = np.full(len(points), -np.inf)
    np.maximum.at(best, point[inside], z[inside])
    return np.where(np.isfinite(best), best, np.inf)
