"""Lookups in maps and tables, in plain numpy: the rule that every implementation follows.

Texel centres lie at (i + 0.5) / W, and outside of them the edge continues, as a GL sampler with
CLAMP_TO_EDGE does.
"""

import numpy as np
import numpy.typing as npt

from pica_core.errors import ShapeError
from pica_core.types import Array, IntArray

Dtype = type[np.float32] | type[np.float64]


def sample_bilinear(texture: npt.ArrayLike, uv: npt.ArrayLike, dtype: Dtype = np.float32) -> Array:
    """Look a map up between its four nearest texels.

    Args:
        texture: Map with row 0 at v = 0. ``[H, W, C]``.
        uv: Texture coordinates; outside [0, 1] the edge continues. ``[..., 2]``.

    Returns:
        Samples ``[..., C]``.

    Raises:
        ShapeError: Not ``[H, W, C]`` and ``[..., 2]``.
    """
    texels, where = np.asarray(texture, dtype), np.asarray(uv, dtype)
    if texels.ndim != 3 or where.shape[-1:] != (2,):
        raise ShapeError(
            f"texture {texels.shape} and uv {where.shape}; [H, W, C] and [..., 2] wanted"
        )
    height, width, _ = texels.shape
    left, right, across = neighbours(where[..., 0], width)
    top, bottom, down = neighbours(where[..., 1], height)
    upper = _mix(texels[top, left], texels[top, right], across)
    lower = _mix(texels[bottom, left], texels[bottom, right], across)
    return _mix(upper, lower, down)


def sample_linear(table: npt.ArrayLike, t: npt.ArrayLike, dtype: Dtype = np.float32) -> Array:
    """Look a table ``[L, C]`` up at `t` ``[...]`` in [0, 1]; returns ``[..., C]``."""
    entries, where = np.asarray(table, dtype), np.asarray(t, dtype)
    if entries.ndim != 2:
        raise ShapeError(f"table is {entries.shape}; [L, C] wanted")
    low, high, weight = neighbours(where, len(entries))
    return _mix(entries[low], entries[high], weight)


def neighbours(t: Array, count: int) -> tuple[Array, Array, Array]:
    """Indices of the two texels around `t` ``[...]``, and the weight of the second ``[..., 1]``."""
    place = t * t.dtype.type(count) - t.dtype.type(0.5)
    floor = np.floor(place)
    low = np.clip(floor, 0, count - 1).astype(np.int64)
    high = np.clip(floor + 1, 0, count - 1).astype(np.int64)
    return low, high, (place - floor)[..., None]


def _mix(a: Array, b: Array, weight: Array) -> Array:
    return a + (b - a) * weight


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
