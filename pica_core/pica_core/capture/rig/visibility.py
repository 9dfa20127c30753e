"""What can be seen of a mesh, by sampling its surface into coarse depth maps; no GPU needed.

Used once per rig: to give texels to what cameras see, and to find the eye openings in a front view.
"""

from dataclasses import dataclass

import numpy as np

from pica_core.capture.triangles import areas, face_normals, spread_samples
from pica_core.types import Float64Array, Int64Array, IntArray

CELL_M = 0.003
"""Cells of the depth maps for `visibility`."""
FRONT_CELL_M = 0.0005
"""Cells of `FrontView`."""
SAMPLES_PER_CELL = 4.0
TOLERANCE_M = 0.004
"""How far behind the nearest sample a triangle may lie and still count as seen."""
MAX_SAMPLES = 4_000_000


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FrontView:
    """The mesh from straight ahead: nearest face per cell, -1 where empty. int64 ``[R, C]``.

    Row 0 is the lowest y; `origin_m` is the corner of the first cell.
    """

    face: Int64Array
    depth_m: Float64Array
    origin_m: Float64Array

    def nearest_z(self, points: Float64Array) -> Float64Array:
        """Height z of the surface that is seen at these x and y; -inf beside it. ``[n]``."""
        cell = ((points[:, :2] - self.origin_m) / FRONT_CELL_M).astype(np.int64)
        rows, columns = self.face.shape
        inside = ((cell >= 0) & (cell < [columns, rows])).all(1)
        cell = np.clip(cell, 0, [columns - 1, rows - 1])
        return np.where(inside, self.depth_m[cell[:, 1], cell[:, 0]], -np.inf)


def _samples(
    points: Float64Array, faces: IntArray, spacing: float
) -> tuple[Int64Array, Float64Array]:
    """Points spread evenly over triangles: face ``[n]`` and barycentric weights ``[n, 3]``."""
    count = np.ceil(areas(points, faces) / spacing**2) + 1
    count = np.maximum(count * min(1.0, MAX_SAMPLES / count.sum()), 1).astype(np.int64)
    which, u, v = spread_samples(count)
    return which, np.stack([1 - u - v, u, v], 1)


def front_view(points: Float64Array, faces: IntArray) -> FrontView:
    """Draw the mesh from straight ahead, orthographically, in cells of `FRONT_CELL_M`."""
    # Coarse triangles need samples by area, hidden ones none: what faces away is left out.
    ahead = np.flatnonzero(face_normals(points, faces)[:, 2] > 0)
    which, weights = _samples(points, faces[ahead], FRONT_CELL_M / 1.6)
    at = np.einsum("nk,nkc->nc", weights, points[faces[ahead[which]]])
    origin = points[:, :2].min(0) - FRONT_CELL_M
    size = np.ceil((points[:, :2].max(0) - origin) / FRONT_CELL_M).astype(np.int64) + 1
    cell = ((at[:, :2] - origin) / FRONT_CELL_M).astype(np.int64)
    flat = cell[:, 1] * size[0] + cell[:, 0]
    order = np.argsort(at[:, 2], kind="stable")  # the nearest sample is written last
    face = np.full(size[0] * size[1], -1, np.int64)
    depth = np.full(size[0] * size[1], -np.inf)
    face[flat[order]] = ahead[which[order]]
    depth[flat[order]] = at[order, 2]
    shape = (int(size[1]), int(size[0]))
    return FrontView(face=face.reshape(shape), depth_m=depth.reshape(shape), origin_m=origin)


def _directions() -> Float64Array:
    """Towards cameras of the dome: 80 degrees to each side, 40 up and down."""
    grid = [(a, e) for e in (-38, -12, 14, 40) for a in (-78, -46, -16, 16, 46, 78)]
    azimuth, elevation = np.radians(np.array(grid, np.float64)).T
    ring = np.cos(elevation)
    return np.stack([np.sin(azimuth) * ring, np.sin(elevation), np.cos(azimuth) * ring], 1)


def visibility(poses: list[Float64Array], faces: IntArray) -> Float64Array:
    """How much of each triangle the dome sees: the best of several poses in metres. ``[F]``.

    That is the mean over cameras of the cosine to the camera where it sees it, 0 to about 0.6.
    """
    best = np.zeros(len(faces))
    spacing = CELL_M / np.sqrt(SAMPLES_PER_CELL)
    which, weights = _samples(poses[0], faces, spacing)
    for points in poses:
        corner = points[faces]
        normal = face_normals(points, faces)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)
        centre = corner.mean(1)
        at = np.einsum("nk,nkc->nc", weights, corner[which])
        total = np.zeros(len(faces))
        directions = _directions()
        for direction in directions:
            right = np.cross([0.0, 1.0, 0.0], direction)
            right /= np.linalg.norm(right)
            plane = np.stack([right, np.cross(direction, right)], 1)
            flat, low = at @ plane, points @ plane
            start = low.min(0)
            columns = int(np.ptp(low[:, 0]) / CELL_M) + 2
            rows = int(np.ptp(low[:, 1]) / CELL_M) + 2
            cell = ((flat - start) / CELL_M).astype(np.int64)
            nearest = np.full(rows * columns, -np.inf)
            np.maximum.at(nearest, cell[:, 1] * columns + cell[:, 0], at @ direction)
            mine = ((centre @ plane - start) / CELL_M).astype(np.int64)
            seen = centre @ direction >= nearest[mine[:, 1] * columns + mine[:, 0]] - TOLERANCE_M
            total += np.maximum(normal @ direction, 0.0) * seen
        best = np.maximum(best, total / len(directions))
    return best
