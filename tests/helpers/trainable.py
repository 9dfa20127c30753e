"""Models of nobody in particular, for tests that need one to train, export or judge."""

from __future__ import annotations

import numpy as np

from helpers.toy import head_surface
from pica_core.model.interface import FacePrior


def toy_prior(
    *, map_size: int = 256, dense: int = 16, tracked: int = 9, scale_m: float = 0.005
) -> FacePrior:
    """The toy's head as a mean face, with two grids over the same UV square.

    Args:
        map_size: Rows and columns of the position map.
        dense: Rows and columns of the dense mesh.
        tracked: The same of the tracked mesh.
        scale_m: Unit of decoded offsets.
    """
    texel = (np.arange(map_size, dtype=np.float32) + 0.5) / map_size
    tracked_uv = grid_uv(tracked)
    position_mean = head_surface(*np.meshgrid(texel, texel))
    return FacePrior(
        position_mean=position_mean,
        tracked_position_mean=position_mean,
        position_scale_m=scale_m,
        dense_uv=grid_uv(dense),
        tracked_uv=tracked_uv,
        tracked_mean_m=head_surface(tracked_uv[:, 0], tracked_uv[:, 1]),
        texture_mean=np.full((64, 64, 3), [0.8, 0.6, 0.5], np.float32),
    )


def grid_uv(count: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """UVs of a square grid of vertices, inside the border texels."""
    corner = np.linspace(0.01, 0.99, count, dtype=np.float32)
    return np.stack(np.meshgrid(corner, corner), -1).reshape(-1, 2)
