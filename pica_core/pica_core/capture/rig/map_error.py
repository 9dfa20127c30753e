"""What a position map of 256 x 256 texels cannot hold of a mesh, whoever fills it.

For each pose the best map in the least-squares sense is found, as a vertex shader reads it:
bilinearly, at the vertices' texture coordinates. What is left is the error that no training can
take away; it depends on the chart alone.
"""

import numpy as np
from scipy.sparse import csc_array, eye_array
from scipy.sparse.linalg import factorized

from pica_core.capture.dataset.files import MAP_SIZE
from pica_core.types import Float64Array, FloatArray


def map_error_m(vertex_uv: FloatArray, poses_m: FloatArray, size: int = MAP_SIZE) -> Float64Array:
    """Distance of every vertex from where the best map of `size` rows and columns puts it, metres.

    Args:
        vertex_uv: Texture coordinates in [0, 1]. float32 ``[V, 2]``.
        poses_m: Meshes, metres. float32 ``[N, V, 3]``.
        size: Rows and columns of the map.

    Returns:
        float64 ``[N, V]``.
    """
    count = len(vertex_uv)
    q = np.clip(vertex_uv.astype(np.float64) * size - 0.5, 0, size - 1)
    low = np.minimum(q.astype(np.int64), size - 2)
    t = q - low
    columns = np.stack([low[:, 0], low[:, 0] + 1, low[:, 0], low[:, 0] + 1], 1)
    rows = np.stack([low[:, 1], low[:, 1], low[:, 1] + 1, low[:, 1] + 1], 1)
    flat = rows * size + columns
    tx, ty = t[:, 0], t[:, 1]
    weight = np.stack([(1 - tx) * (1 - ty), tx * (1 - ty), (1 - tx) * ty, tx * ty], 1)
    vertex = np.repeat(np.arange(count), 4)
    read = csc_array((weight.ravel(), (vertex, flat.ravel())), (count, size * size))
    # Texels that nothing reads are free; a vertex on a texel centre reads one only.
    solve = factorized((read.T @ read + 1e-9 * eye_array(size * size)).tocsc())
    wanted = poses_m.astype(np.float64).transpose(1, 0, 2).reshape(count, -1)
    spread = read.T @ wanted
    solution = np.stack([solve(column) for column in spread.T], 1)
    residual = wanted - read @ solution
    return np.linalg.norm(residual.reshape(count, -1, 3), axis=2).T
