"""Position map -> mesh vertices. The GPU does the same lookup in the vertex shader; this is its
judge."""

import numpy as np
import numpy.typing as npt

from pica_core.errors import ShapeError
from pica_core.reference.sampling import sample_bilinear
from pica_core.types import Array, IntArray


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


def order_faces(faces: IntArray, vertex_uv: npt.ArrayLike) -> IntArray:
    """Sort triangles along a space-filling curve in UV, so that neighbours are drawn together.

    A renderer that keeps its last few vertices computes each of them once or twice instead of six
    times. Which triangles there are, and their winding, stays.

    Args:
        faces: int32 ``[F, 3]``.
        vertex_uv: In [0, 1], ``[V, 2]``.

    Returns:
        The same triangles in another order, int32 ``[F, 3]``.
    """
    uv = np.asarray(vertex_uv, np.float32)[faces].mean(axis=1)
    cell = np.clip(uv * 1024, 0, 1023).astype(np.uint32)
    code = np.zeros(len(faces), np.uint32)
    for bit in range(10):  # Morton order: the bits of u and v, interleaved
        code |= ((cell[:, 0] >> bit) & 1) << (2 * bit)
        code |= ((cell[:, 1] >> bit) & 1) << (2 * bit + 1)
    return np.ascontiguousarray(faces[np.argsort(code, kind="stable")])
