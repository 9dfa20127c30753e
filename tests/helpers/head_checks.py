"""What may go wrong when a head moves, counted on posed vertices: folds, and parts that poke out.

Pure numpy: no drawing, so thousands of expressions can be checked. Millimetres throughout.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pica_core.capture.dataset.files import MAP_SIZE
from pica_core.capture.procedural.heads import ProceduralHead
from pica_core.capture.triangles import edge_neighbours
from pica_core.types import Float64Array, Int64Array

SMALL_MM2 = 0.25
"""Smaller faces are left out: half a millimetre across, a pixel of a whole-head picture."""
CELL_MM = 2.0
ROW = 1 << 20
"""Cells in a row of the grid in which faces are listed: more than there ever are."""
POKE_MM = 0.15
"""How far a part must stand out of the skin to count: about a pixel of a close camera."""


@dataclass(frozen=True, kw_only=True, slots=True)
class HeadFaults:
    """What is wrong with one posed head."""

    folded: int
    """Skin triangles that face against their surroundings though they do not at rest."""
    eyes: int
    """Places on the eyeballs in front of the lids or the skin around them."""
    teeth: int
    """Places on the teeth in front of lips or cheeks."""
    clearance_mm: float
    """Least depth of an eyeball or tooth below the skin over it; negative where one pokes out."""

    @property
    def total(self) -> int:
        """All faults."""
        return self.folded + self.eyes + self.teeth


def grid_lines(head: ProceduralHead, chart: str) -> tuple[Int64Array, Int64Array]:
    """Rows and columns of the UV square, in texels, whose crossings are a chart's vertices."""
    texels = np.rint(head.vertex_uv[head.charts[chart]] * MAP_SIZE - 0.5).astype(np.int64)
    return np.unique(texels[:, 1]), np.unique(texels[:, 0])


class HeadChecks:
    """Checks of one head; what never changes is prepared once.

    Args:
        head: The head.
    """

    def __init__(self, head: ProceduralHead) -> None:
        self.head = head
        skin = head.charts["skin"]
        on_skin = ((head.faces >= skin.start) & (head.faces < skin.stop)).all(1)
        self._skin = head.faces[on_skin].astype(np.int64)
        self._pairs = edge_neighbours(self._skin)
        rest = head.vertices(np.zeros(52)).astype(np.float64) * 1000.0
        self.rest = rest
        self._folded_at_rest = self._folds(rest)
        z = rest[self._skin].mean(1)[:, 2]
        y = rest[self._skin].mean(1)[:, 1]
        eye_y = float(rest[head.regions["eyeballs"], 1].mean())
        mouth_y = float(rest[head.regions["lips"], 1].mean())
        self._around_eyes = self._skin[(z > 55) & (np.abs(y - eye_y) < 22)]
        self._around_mouth = self._skin[(z > 40) & (np.abs(y - mouth_y) < 42)]
        teeth = np.flatnonzero(head.regions["teeth"])
        rows = np.concatenate(
            [np.repeat(np.linspace(0, 1, 17), len(grid_lines(head, n)[1])) for n in _ARCHES]
        )
        front = np.zeros(len(head.vertex_uv), np.bool_)
        front[teeth[rows < 0.8]] = True
        self._teeth = head.faces[front[head.faces].all(1)].astype(np.int64)
        self._eyes = head.faces[head.regions["eyeballs"][head.faces].all(1)].astype(np.int64)

    def _normals(self, vertices: Float64Array) -> Float64Array:
        a, b, c = (vertices[self._skin[:, k]] for k in range(3))
        normals: Float64Array = np.cross(b - a, c - a)
        return normals

    def _folds(self, vertices: Float64Array) -> npt.NDArray[np.bool_]:
        normals = self._normals(vertices)
        size = np.linalg.norm(normals, axis=1)
        around = np.zeros_like(normals)
        first, second = self._pairs
        np.add.at(around, first, normals[second])
        np.add.at(around, second, normals[first])
        length = np.linalg.norm(around, axis=1)
        against = (normals * around).sum(1) < -0.3 * size * length
        folded: npt.NDArray[np.bool_] = against & (0.5 * size > SMALL_MM2)
        return folded

    def folded(self, vertices: Float64Array) -> Int64Array:
        """Indices into the skin's triangles that fold over."""
        return np.flatnonzero(self._folds(vertices) & ~self._folded_at_rest)

    def clearance(self, vertices: Float64Array) -> list[tuple[Float64Array, Float64Array]]:
        """How far below the skin eyeballs and teeth lie, seen from the front.

        Looked at are vertices and the middles of faces.

        Returns:
            For eyeballs, then for teeth: points ``[P, 3]`` and depth below the skin ``[P]``, mm,
            +inf where no skin covers the point.
        """
        out = []
        for inner, faces in ((self._eyes, self._around_eyes), (self._teeth, self._around_mouth)):
            points = np.concatenate([vertices[np.unique(inner)], vertices[inner].mean(1)])
            out.append((points, front_depth(vertices, faces, points) - points[:, 2]))
        return out

    def poking(self, vertices: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Points of eyeballs and of teeth that stand out of the skin, mm. ``[P, 3]`` each."""
        eyes, teeth = (points[below < -POKE_MM] for points, below in self.clearance(vertices))
        return eyes, teeth

    def faults(self, arkit: npt.ArrayLike) -> HeadFaults:
        """Pose the head and count."""
        vertices = self.head.vertices(arkit).astype(np.float64) * 1000.0
        eyes, teeth = (below for _, below in self.clearance(vertices))
        return HeadFaults(
            folded=len(self.folded(vertices)),
            eyes=int((eyes < -POKE_MM).sum()),
            teeth=int((teeth < -POKE_MM).sum()),
            clearance_mm=float(min(eyes.min(), teeth.min())),
        )


_ARCHES = ("teeth_upper", "teeth_lower")


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
