"""What may go wrong when a head of any mesh moves: folds, and parts that poke out of each other.

Pure numpy: no drawing, so thousands of expressions can be checked. Metres in, millimetres inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.rig.features import Limits, find_features
from pica_core.capture.rig.guards import PoseGuard
from pica_core.capture.rig.mesh import RigMesh
from pica_core.capture.triangles import face_neighbours
from pica_core.types import BoolArray, Float64Array, FloatArray, Int64Array, IntArray

SKIN, EYE, TEETH, COLLAR, HAIR = (
    MATERIALS.index(name) for name in ("skin", "eye", "teeth", "collar", "hair")
)
SMALL_MM2 = 0.25
"""Smaller faces are left out: half a millimetre across, a pixel of a whole-head picture."""
CELL_MM = 2.0
ROW = 1 << 20
"""Cells in a row of the grid in which faces are listed: more than there ever are."""
POKE_MM = 0.15
"""How far a part must stand out of the skin to count: about a pixel of a close camera."""
TURNS = (0.0, 90.0, 180.0, 270.0)
"""Degrees about the head from which clothes and hair are looked at."""
UNDER_MM = 12.0
"""Skin that lies so near behind clothes or hair at rest is under them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class MeshFaults:
    """What is wrong with one posed head; places are millimetres, for a picture of the worst."""

    folded: int
    """Triangles of skin, hair and clothes over 0.25 mm² that face against their neighbours."""
    eyes: int
    """Places on eyeballs more than 0.15 mm in front of the skin, from the front."""
    teeth: int
    """Places on teeth more than 0.15 mm in front of the skin, from the front."""
    through: int
    """Places on skin that lie under clothes or hair at rest and stand out of them now."""

    @property
    def total(self) -> int:
        """All faults."""
        return self.folded + self.eyes + self.teeth + self.through


class MeshChecks:
    """Checks of one mesh in its welded form; what never changes is prepared once."""

    def __init__(self, mesh: RigMesh) -> None:
        features = find_features(mesh)
        part = features.part
        self._limits, self._guard = Limits(mesh, features), PoseGuard(mesh, features)
        self._rest = 1000 * mesh.rest_m
        moving = np.abs(mesh.motion_m).max((1, 2)) > 0
        self._shapes = np.flatnonzero(moving)
        self._motion: FloatArray = 1000 * mesh.motion_m[self._shapes].reshape(moving.sum(), -1)
        faces = mesh.faces.astype(np.int64)
        self._outer = faces[np.isin(part, [SKIN, HAIR, COLLAR])]
        self._order, self._start, self._pairs = face_neighbours(self._outer)
        self.folded_at_rest = self._folds(self._rest)
        middle = self._rest[faces].mean(1)
        eyes = self._rest[np.unique(faces[part == EYE])]
        skin, eye_y, eye_z = part == SKIN, float(eyes[:, 1].mean()), float(eyes[:, 2].mean())
        teeth_y = float(self._rest[np.unique(faces[part == TEETH]), 1].mean())
        ahead = middle[:, 2] > 40
        lids = skin & (middle[:, 2] > eye_z + 2) & (np.abs(middle[:, 1] - eye_y) < 22)
        self._inner = (  # of an eye's socket only what lies before the eyeball
            (faces[part == EYE], faces[lids]),
            (faces[part == TEETH], faces[skin & ahead & (np.abs(middle[:, 1] - teeth_y) < 46)]),
        )
        self._layers = list(self._find_layers(faces, part))

    def _find_layers(
        self, faces: Int64Array, part: IntArray
    ) -> list[tuple[float, Int64Array, Int64Array]]:
        """For each side: skin vertices under a layer of clothes or hair, and the layer."""
        skin, layers = np.unique(faces[part == SKIN]), []
        for layer in (COLLAR, HAIR):
            over = faces[part == layer]
            for turn in TURNS if len(over) else ():
                seen = _turned(self._rest, turn)
                depth = front_depth(seen, over, seen[skin]) - seen[skin, 2]
                under = skin[(depth > POKE_MM) & (depth < UNDER_MM)]
                if len(under):
                    layers.append((turn, under, over))
        return layers

    def pose(self, arkit: Float64Array) -> Float64Array:
        """Vertices at the 52 shapes, millimetres ``[P, 3]``."""
        values = self._limits.apply(arkit)
        points = self._rest + (values[self._shapes] @ self._motion).reshape(-1, 3)
        points /= 1000
        self._guard.apply(points)
        return 1000 * points

    def _folds(self, points: Float64Array) -> BoolArray:
        a, b, c = (points[self._outer[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        around = np.add.reduceat(normal[self._pairs], self._start, axis=0)
        normal = normal[self._order]
        size, length = np.linalg.norm(normal, axis=1), np.linalg.norm(around, axis=1)
        against: BoolArray = (normal * around).sum(1) < -0.3 * size * length
        return against & (0.5 * size > SMALL_MM2)

    def folds(self, points: Float64Array) -> Float64Array:
        """Middles of the triangles that fold though they do not at rest. ``[n, 3]``."""
        new = self._folds(points) & ~self.folded_at_rest
        return points[self._outer[self._order[new]]].mean(1)

    def pokes(self, points: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Places of eyeballs, of teeth and of covered skin that stand out. ``[n, 3]`` each."""
        out = []
        for inner, outer in self._inner:
            places = np.concatenate([points[np.unique(inner)], points[inner].mean(1)])
            deep = front_depth(points, outer, places) - places[:, 2]
            out.append(places[deep < -POKE_MM])
        through = [np.zeros((0, 3))]
        for turn, under, over in self._layers:
            seen = _turned(points, turn)
            deep = front_depth(seen, over, seen[under]) - seen[under, 2]
            through.append(points[under[(deep < -POKE_MM) & (deep > -UNDER_MM)]])
        return out[0], out[1], np.concatenate(through)

    def faults(self, arkit: Float64Array) -> MeshFaults:
        """Pose the head and count."""
        points = self.pose(arkit)
        eyes, teeth, through = self.pokes(points)
        return MeshFaults(
            folded=len(self.folds(points)), eyes=len(eyes), teeth=len(teeth), through=len(through)
        )


def _turned(points: Float64Array, degrees: float) -> Float64Array:
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return points @ np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])


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
