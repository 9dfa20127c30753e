"""A textured head of few vertices, for drawing alone: its decoder's tensors are zeros."""

import numpy as np

from pica_core.reference import FIRST_SIZE, BaselineAvatar, BaselineSpec
from pica_core.types import FloatArray, IntArray

Corner = tuple[float, float, float]


def painted_head(
    vertex_uv: FloatArray, faces: IntArray, low_m: Corner, high_m: Corner, texture_size: int
) -> BaselineAvatar:
    """A baseline with a mesh, and a texture of ``FIRST_SIZE`` times a power of two."""
    num_layers = (texture_size // FIRST_SIZE).bit_length() - 1
    channels = (*(1,) * (num_layers - 1), 3)
    spec = BaselineSpec(num_latent=1, num_vertices=len(vertex_uv), channels=channels)
    assert spec.texture_size == texture_size
    return BaselineAvatar(
        spec=spec,
        tensors={name: np.zeros(shape) for name, shape in spec.tensor_shapes().items()},
        vertex_uv=vertex_uv,
        faces=faces,
        bounds_min_m=low_m,
        bounds_max_m=high_m,
    )
