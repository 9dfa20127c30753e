"""Texels of a learned map that no picture showed to training.

They keep their random start, and would be drawn torn and grey where a viewer looks from another
side than every camera did. At export each takes the mean of texels near it that training saw:
near on the mean mesh, and of the same regions and the same island of the UV layout, so that a
sleeve is filled from the sleeve.
"""

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import KDTree

from pica_core.capture.triangles import components
from pica_core.train.data.training import TrainingData
from pica_core.train.data.uv_raster import rasterise_uv
from pica_core.types import BoolArray, FloatArray

MARGIN_RATIO = 1 / 128
"""Seen texels nearer to an unseen one, of the map's width, lend nothing: few pixels, seen edge-on,
made them what they are (chosen by looking at six people)."""
NEIGHBOURS = 12
"""Texels whose mean an unseen one takes."""


def fill_unseen(values: FloatArray, is_seen: BoolArray, data: TrainingData) -> FloatArray:
    """Give the unseen texels of a map the values of seen ones near them.

    Args:
        values: Row 0 is v = 0, ``[T, T, C]``.
        is_seen: Which texels training saw, ``[T, T]``.

    Returns:
        A new map, ``[T, T, C]``. Seen texels, texels outside of the UV layout and parts of it of
        which training saw too little are as they were.
    """
    topology = data.capture.topology
    raster = rasterise_uv(topology.vertex_uv, topology.faces, len(values))
    points_m = (data.meshes.dense_mean_m[raster.corners] * raster.weights[:, :, None]).sum(1)
    island = components(topology.faces, len(topology.vertex_uv))
    marks = np.stack([island, *topology.regions.values()], 1)
    part = np.unique(marks, axis=0, return_inverse=True)[1].reshape(-1)[raster.corners[:, 0]]
    is_hole = raster.covered & ~is_seen
    margin = MARGIN_RATIO * len(values)
    lends = (distance_transform_edt(~is_hole) > margin)[raster.covered]
    needs = is_hole[raster.covered]
    inside = values[raster.covered]
    filled = inside.copy()
    for each in np.unique(part[needs]):
        lenders = np.flatnonzero((part == each) & lends)
        holes = np.flatnonzero((part == each) & needs)
        if len(lenders) >= NEIGHBOURS:
            _, near = KDTree(points_m[lenders]).query(points_m[holes], NEIGHBOURS)
            filled[holes] = inside[lenders[near]].mean(1)
    result: FloatArray = values.copy()
    result[raster.covered] = filled
    return result
