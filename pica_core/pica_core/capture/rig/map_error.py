"""What a position map of 256 x 256 texels cannot hold of a mesh, whoever fills it.

For each pose the best map in the least-squares sense is found, as a vertex shader reads it:
bilinearly, at the vertices' texture coordinates. What is left is the error that no training can
take away; it depends on the chart alone.
"""

import numpy as np

from pica_core.capture.dataset.files import MAP_SIZE
from pica_core.types import Float64Array, FloatArray

ITERATIONS = 60


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
    # Texels that nothing reads would be free: a vertex on a texel centre reads one only.
    weight = np.maximum(weight, 1e-9)
    texels, flat = np.unique(flat, return_inverse=True)
    flat = flat.reshape(count, 4)
    order = np.argsort(flat, axis=None, kind="stable")
    starts = np.searchsorted(flat.ravel()[order], np.arange(len(texels)))
    from_vertex, from_weight = order // 4, weight.ravel()[order][:, None]

    def read(values: Float64Array) -> Float64Array:
        return np.einsum("vk,vkc->vc", weight, values[flat])

    def spread(values: Float64Array) -> Float64Array:
        return np.add.reduceat(values[from_vertex] * from_weight, starts, axis=0)

    wanted = poses_m.astype(np.float64).transpose(1, 0, 2).reshape(count, -1)
    # Conjugate gradients on the normal equations (CGLS), all columns at once.
    solution = spread(wanted) / spread(np.ones((count, 1)))
    residual = wanted - read(solution)
    gradient = spread(residual)
    direction = gradient.copy()
    norm = (gradient * gradient).sum(0)
    for _ in range(ITERATIONS):
        image = read(direction)
        step = norm / np.maximum((image * image).sum(0), 1e-30)
        solution += step * direction
        residual -= step * image
        gradient = spread(residual)
        after = (gradient * gradient).sum(0)
        direction = gradient + after / np.maximum(norm, 1e-30) * direction
        norm = after
    return np.linalg.norm(residual.reshape(count, -1, 3), axis=2).T
