"""The rims of a mesh, for tests that it has no new ones."""

from __future__ import annotations

import numpy as np

from pica_core.types import Array


def boundary_edges(faces: Array, same_place: Array | None = None) -> Array:
    """Edges that only one triangle has, as pairs of vertices, int64 ``[B, 2]``.

    Args:
        faces: ``[F, 3]``.
        same_place: Names the places of vertices as `weld` does; then edges of a UV seam that meet
            on both sides are no boundary. Triangles without area in these names do not count.
    """
    corners = faces if same_place is None else same_place[faces]
    a, b, c = corners.T
    corners = corners[(a != b) & (b != c) & (c != a)].astype(np.int64)
    edges = np.sort(corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    alone: Array = unique[count == 1]
    return alone
