"""Coarser triangles over some of the same vertices, chosen by the error that they leave.

Edges are collapsed in the order of the error that this adds, as quadrics measure it (Garland and
Heckbert, "Surface Simplification Using Quadric Error Metrics", 1997, and "Simplifying Surfaces with
Color and Texture using Quadric Error Metrics", 1998). Ours, since libraries that do this move
vertices, tear seams or come without binaries:

- A collapse moves a vertex onto a neighbour: what stays is a subset of the vertices.
- The error is that of several shapes at once, at rest and in strong expressions, so a mouth that is
  a line at rest keeps what it needs to open; at rest it holds UVs as well as places.
- Vertices in one place with several UVs (a seam) move together, each to the one of its own side, or
  not at all; a border or slit is only shortened along itself. So nothing tears.
- No triangle may turn over, neither in space nor in UV.
"""

import heapq

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from pica_core.capture.triangles import areas, components, edges
from pica_core.sampling import order_faces
from pica_core.types import Array, BoolArray, Int64Array, IntArray

WELD_M = 2e-5
"""Vertices this near to each other at rest are one place with several UVs. Files keep positions to
5 micrometres."""
UV_WEIGHT = 1.5
"""How much an error of UV counts, where one unit of UV is as long as the mesh and places count 1
(measured on two heads: docs/architecture.md)."""
UV_AREA_WEIGHT = 0.3
"""How much a triangle's room in UV counts against its area: layouts give lids and lips more room.
With 0 lips at 64 look torn, with 1 temples show through the hair (seen on one avatar)."""
BORDER_WEIGHT = 4.0
"""How much a border's own line counts against the surface beside it: lips and lids are borders."""
LEAST_COSINE = (0.2, 0.0)
"""How far a triangle may turn by one collapse: at rest, and in the other shapes."""


class Simplifier:
    """A mesh that loses triangles and keeps its looks in all its shapes.

    Args:
        shapes_m: The mesh at rest, then in other expressions, metres. ``[K, V, 3]``.
        vertex_uv: ``[V, 2]``.
        faces: int32 ``[F, 3]``.
        importance: How much an error at each vertex counts, ``[V]``; all alike without.

    A *place* is a point of the surface, a *vertex* one of its UVs. Costs are inner products of two
    packed symmetric matrices: what faces a vertex has swallowed, and where it would go.
    """

    def __init__(
        self,
        shapes_m: npt.ArrayLike,
        vertex_uv: npt.ArrayLike,
        faces: Array,
        importance: Array | None = None,
    ) -> None:
        shapes, uv = np.asarray(shapes_m, np.float64), np.asarray(vertex_uv, np.float64)
        self._place = weld(shapes[0]).tolist()
        # One shape for all vertices of a place, so that seams stay closed to the last bit.
        shapes = (shapes - shapes[0].mean(axis=0)) / np.ptp(shapes[0], axis=0).max()
        self._shapes = np.ascontiguousarray(shapes[:, self._place].transpose(1, 0, 2))  # [V, K, 3]
        self._uv = uv
        self._importance = np.ones(len(uv)) if importance is None else importance
        self._triangles: dict[int, list[int]] = {}
        self._around: dict[int, set[int]] = {}
        for corners in faces.tolist():
            if len({self._place[corner] for corner in corners}) < 3:
                continue
            number = len(self._triangles)
            for corner in corners:
                self._around.setdefault(self._place[corner], set()).add(number)
            self._triangles[number] = corners
        whole = np.array(list(self._triangles.values()), np.int64)
        self._goals = self._pack_goals()
        self._swallowed = self._pack_faces(whole)
        self._stamp = dict.fromkeys(self._around, 0)
        self._queue: list[tuple[float, int, int, int, int]] = []

    def faces(self) -> IntArray:
        """What is left: same vertices, same winding, neighbours together. int32 ``[F', 3]``."""
        return order_faces(np.array(list(self._triangles.values()), np.int32), self._uv)

    def reduce(self, num_triangles: int) -> None:
        """Collapse edges, cheapest first, down to so many triangles; seams and slits may need
        more."""
        self._queue.clear()
        for a in self._around:
            for b in self._neighbours(a):
                self._offer(a, b)
        while len(self._triangles) > num_triangles and self._queue:
            _, a, b, stamp_a, stamp_b = heapq.heappop(self._queue)
            if self._stamp.get(a) != stamp_a or self._stamp.get(b) != stamp_b:
                continue
            moves = self._moves(a, b)
            if moves is not None and self._may_collapse(a, b, moves):
                self._collapse(a, b, moves)

    def _pack_goals(self) -> Array:
        """Packed outer products of every vertex's places (and UV at rest) with themselves."""
        one = np.ones((len(self._uv), 1))
        rest = np.concatenate([self._shapes[:, 0], UV_WEIGHT * self._uv, one], axis=1)
        packed = [_pack_outer(rest)]
        for shape in range(1, self._shapes.shape[1]):
            packed.append(_pack_outer(np.concatenate([self._shapes[:, shape], one], axis=1)))
        return np.concatenate(packed, axis=1)

    def _pack_faces(self, triangles: Array) -> Array:
        """Packed quadrics of the triangles and borders around every vertex."""
        places = np.asarray(self._place)[triangles]
        borders = _alone(places)
        room = np.abs(_uv_area(self._uv[triangles]))
        total = []
        for shape in range(self._shapes.shape[1]):
            points = self._shapes[:, shape]
            flat = points if shape else np.concatenate([points, UV_WEIGHT * self._uv], axis=1)
            corners = flat[triangles]
            area = areas(points, triangles)
            weight = area + UV_AREA_WEIGHT * area.sum() * room / room.sum()
            weight *= self._importance[triangles].mean(1)
            matrix = _flat_quadrics(corners) * weight[:, None, None]
            for side, is_border in enumerate(borders.T):
                start, end = corners[is_border, side], corners[is_border, (side + 1) % 3]
                along = (end - start)[:, :3]
                length = np.linalg.norm(along, axis=1)[:, None, None]
                line = _quadrics(start[:, :3], [_unit(along)]) * length**2
                # The line's own term speaks of places alone.
                index = [0, 1, 2, matrix.shape[1] - 1]
                matrix[np.ix_(is_border, index, index)] += BORDER_WEIGHT * line
            packed = _pack(matrix)
            sums = np.zeros((len(points), packed.shape[1]))
            for side in range(3):
                np.add.at(sums, triangles[:, side], packed)
            total.append(sums)
        return np.concatenate(total, axis=1)

    def _offer(self, a: int, b: int) -> None:
        """Queue the collapse of place a onto place b, if every side of a has one to go to."""
        moves = self._moves(a, b)
        if moves is not None:
            cost = sum(
                float(self._swallowed[start] @ self._goals[end]) for start, end in moves.items()
            )
            heapq.heappush(self._queue, (cost, a, b, self._stamp[a], self._stamp[b]))

    def _moves(self, a: int, b: int) -> dict[int, int] | None:
        """Which vertex of b each vertex of a would become; None if that is not one and only one."""
        moves: dict[int, int] = {}
        used: set[int] = set()
        for number in self._around[a]:
            corners = self._triangles[number]
            start, end = -1, -1
            for corner in corners:
                if self._place[corner] == a:
                    start = corner
                elif self._place[corner] == b:
                    end = corner
            used.add(start)
            if end >= 0 and moves.setdefault(start, end) != end:
                return None
        return moves if len(moves) == len(used) else None

    def _may_collapse(self, a: int, b: int, moves: dict[int, int]) -> bool:
        shared = self._around[a] & self._around[b]
        if len(shared) > 2 or (len(shared) == 2 and self._is_border(a)):
            return False
        tips = {p for number in shared for p in self._corner_places(number)} - {a, b}
        if self._neighbours(a) & self._neighbours(b) != tips or len(tips) != len(shared):
            return False
        before, after = [], []
        for number in self._around[a] - shared:
            corners = self._triangles[number]
            before.append(corners)
            after.append([moves.get(c, c) if self._place[c] == a else c for c in corners])
        if not before:
            return False  # the last triangles of a piece
        old, new = _normals(self._shapes[before]), _normals(self._shapes[after])
        least = np.full(old.shape[1], LEAST_COSINE[1])
        least[0] = LEAST_COSINE[0]
        sizes = np.linalg.norm(old, axis=2) * np.linalg.norm(new, axis=2)
        if ((old * new).sum(axis=2) < least * sizes).any() or (sizes[:, 0] < 1e-16).any():
            return False
        turn = _uv_area(self._uv[before]) * _uv_area(self._uv[after])
        return bool((turn > 0).all())

    def _collapse(self, a: int, b: int, moves: dict[int, int]) -> None:
        for number in self._around.pop(a):
            corners = self._triangles[number]
            if any(self._place[corner] == b for corner in corners):
                del self._triangles[number]
                for corner in corners:
                    if self._place[corner] != a:
                        self._around[self._place[corner]].discard(number)
            else:
                kept = [moves[c] if self._place[c] == a else c for c in corners]
                self._triangles[number] = kept
                self._around[b].add(number)
        for start, end in moves.items():
            self._swallowed[end] += self._swallowed[start]
        del self._stamp[a]
        around = self._neighbours(b)
        # Costs changed at b alone; what may go changed around it, too.
        self._stamp[b] += 1
        for place in around:
            self._offer(place, b)
            self._offer(b, place)

    def _corner_places(self, number: int) -> list[int]:
        return [self._place[corner] for corner in self._triangles[number]]

    def _neighbours(self, place: int) -> set[int]:
        found = {p for number in self._around[place] for p in self._corner_places(number)}
        found.discard(place)
        return found

    def _is_border(self, place: int) -> bool:
        """Whether an edge at this place has one triangle only."""
        count: dict[int, int] = {}
        for number in self._around[place]:
            for other in self._corner_places(number):
                count[other] = count.get(other, 0) + 1
        count.pop(place, None)
        return any(number == 1 for number in count.values())


def _alone(triangles: Array) -> BoolArray:
    """Whether no other triangle has the side, for each side of each triangle. ``[F, 3]``."""
    sides = np.sort(edges(triangles), axis=1)
    _, inverse, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    return count[inverse.reshape(-1)].reshape(-1, 3) == 1


def _normals(corners: Array) -> Array:
    """Twice the area times the normal, of triangles ``[T, 3, K, 3]`` in K shapes: ``[T, K, 3]``."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    # np.cross takes five times as long for a handful of triangles.
    left, right = first[..., [1, 2, 0]], second[..., [1, 2, 0]]
    return (left * second[..., [2, 0, 1]]) - first[..., [2, 0, 1]] * right


def _uv_area(corners: Array) -> Array:
    sides = corners[:, 1:] - corners[:, :1]
    return sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]


def _flat_quadrics(corners: Array) -> Array:
    """Squared distance from the plane of triangles ``[F, 3, D]``, as ``[F, D + 1, D + 1]``."""
    first = _unit(corners[:, 1] - corners[:, 0])
    second = corners[:, 2] - corners[:, 0]
    second = _unit(second - (second * first).sum(axis=1, keepdims=True) * first)
    return _quadrics(corners[:, 0], [first, second])


def _quadrics(origin: Array, directions: list[Array]) -> Array:
    """Squared distance from what unit vectors span through an origin, homogeneous."""
    size = origin.shape[1]
    across = np.broadcast_to(np.eye(size), (len(origin), size, size)).copy()
    for direction in directions:
        across -= direction[:, :, None] * direction[:, None]
    matrix = np.zeros((len(origin), size + 1, size + 1))
    shift = -np.einsum("fij,fj->fi", across, origin)
    matrix[:, :size, :size] = across
    matrix[:, :size, size] = matrix[:, size, :size] = shift
    matrix[:, size, size] = -(shift * origin).sum(axis=1)
    return matrix


def _unit(vectors: Array) -> Array:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)


def _pack(matrices: Array) -> Array:
    """Upper triangles of symmetric matrices ``[N, D, D]`` as rows."""
    rows, columns = np.triu_indices(matrices.shape[1])
    return matrices[:, rows, columns]


def _pack_outer(vectors: Array) -> Array:
    """x x^T packed so that its product with `_pack` of Q is x^T Q x."""
    rows, columns = np.triu_indices(vectors.shape[1])
    return vectors[:, rows] * vectors[:, columns] * np.where(rows == columns, 1.0, 2.0)


def weld(vertices_m: npt.ArrayLike) -> Int64Array:
    """For every vertex ``[V, 3]`` the first of those that lie in the same place, no further than
    `WELD_M` from each other: indices of vertices, ``[V]``."""
    vertices = np.asarray(vertices_m, np.float64)
    pairs = KDTree(vertices).query_pairs(WELD_M, output_type="ndarray")
    place = components(pairs[:, [0, 1, 1]], len(vertices))
    first: Int64Array = np.unique(place, return_index=True)[1]
    return first[place]
