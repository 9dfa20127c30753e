"""Position map -> mesh vertices. The GPU does the same lookup in the vertex shader; this is its
judge."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pica_core.errors import ShapeError
from pica_core.pixel_reference import sample_bilinear

Array = npt.NDArray[Any]


def sample_vertices(position_map: npt.ArrayLike, vertex_uv: npt.ArrayLike) -> Array:
    """Turn a decoded position map into mesh vertices, by bilinear lookup at each vertex's UV.

    Args:
        position_map: Head-frame xyz in metres; row 0 is v = 0. float32 ``[H, W, 3]``.
        vertex_uv: Texture coordinates in [0, 1], texel centres at (i + 0.5) / W. float32 ``[V,
            2]``.

    Returns:
        Vertex positions in metres. float32 ``[V, 3]``.

    Raises:
        ShapeError: A trailing dimension is not 3 or 2.

    Not checked: UVs outside [0, 1] clamp to the border, as the GPU sampler does.
    Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), section 3 "Geometry Decoder"; S(.) in
        appendix A.2.
    """
    positions = np.asarray(position_map, np.float32)
    if positions.shape[-1:] != (3,):
        raise ShapeError(f"position_map is {positions.shape}; [H, W, 3] is needed")
    return sample_bilinear(positions, vertex_uv)


def vertex_normals(vertices_m: npt.ArrayLike, faces: npt.NDArray[np.int32]) -> Array:
    """Unit normals, each the mean of its triangles' normals weighted by their areas.

    Args:
        vertices_m: ``[V, 3]``.
        faces: Counter-clockwise seen from outside. int32 ``[F, 3]``.

    Returns:
        float64 ``[V, 3]``, pointing outside; zero where a vertex has no triangle of any area.
    """
    vertices = np.asarray(vertices_m, np.float64)
    corners = vertices[faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], face_normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit: Array = normals / np.where(length > 0, length, 1)
    return unit
