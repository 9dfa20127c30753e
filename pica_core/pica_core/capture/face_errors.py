"""Where a driven face is wrong: parts that poke out, and lids and lips that are not where they
should be.

A mean over all pixels hides what people see first, an eyeball that shows through a closed lid.
These figures compare a face with its truth, both posed by the same values:

    poking             pixels of the head that show another part than the truth does anywhere near:
                       teeth through a lip, an eyeball through a lid, skin over an open eye.
                       Silhouettes do not count, the error of the picture has them.
    region_errors_mm   mean distance of a region's vertices from where they should be

Pictures of parts hold 0 where no head is, else the part's index in `MATERIALS` + 1.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pica_core.types import BoolArray, ByteArray, FloatArray

REACH_PX: Final = 1
"""How far an edge may be off before it counts, pixels: who owns a pixel at an edge is chance."""


def poking(shown: ByteArray, truth: ByteArray) -> BoolArray:
    """Pixels that show a part which the truth has nowhere within `REACH_PX`.

    Args:
        shown: Parts that were drawn, 0 where no head is. uint8 ``[H, W]``.
        truth: Parts as they should be. uint8 ``[H, W]``.

    Returns:
        bool ``[H, W]``; False where only one of the two shows a head.
    """
    side = 2 * REACH_PX + 1
    around = sliding_window_view(np.pad(truth, REACH_PX), (side, side))
    elsewhere = (around != shown[..., None, None]).all(axis=(-2, -1))
    return elsewhere & (shown > 0) & (truth > 0)


def region_errors_mm(
    vertices_m: FloatArray, truth_m: FloatArray, regions: Mapping[str, BoolArray]
) -> dict[str, float]:
    """Mean distance of vertices from the truth, by region; regions without a vertex are left out.

    Args:
        vertices_m: Vertices of any mesh, metres. float32 ``[V, 3]``.
        truth_m: Where they should be; for a coarser mesh the same vertices of the fine one.
        regions: Masks of them, bool ``[V]`` each.

    Returns:
        Millimetres by the name of the region.
    """
    distance_mm = 1000 * np.linalg.norm(vertices_m.astype(np.float64) - truth_m, axis=1)
    return {name: float(distance_mm[mask].mean()) for name, mask in regions.items() if mask.any()}
