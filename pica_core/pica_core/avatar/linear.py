"""Geometry as a linear function of the latent: names, shapes and checks of its tensors.

An avatar whose spec says `bases` has no position map. Its vertices lie in a sheet, `REGION` to a
row: vertex number k stands in row k // REGION and column k % REGION. Each row is a region of the
chart with as many directions of its own as its movement needs:

    w         = linear.weight . latent + linear.bias              K weights of the whole
    local     = linear.mix . w                                    L weights, region after region
    sheet[r]  = linear.mean[r] + scale * (its local . its rows of linear.basis)

Scale is the manifest's `position_scale_m`. Float32 in memory unless stated:

    linear.weight [K, 256]   linear.bias [K]   linear.mix [L, K]
    linear.basis  [L, REGION, 3]               1 is the farthest that a direction moves; 8 bits
    linear.mean   [R, REGION, 3] metres        16 bits
    linear.rank   [R] int32                    directions of each region, L in all

What a region's directions come from: `pica_core.model.bases`.
"""

from collections.abc import Mapping

import numpy as np

from pica_core.avatar.spec import POSITION_CHANNELS, SHEET_COLUMNS
from pica_core.latent import NUM_LATENT
from pica_core.types import Array, FloatArray, IntArray

PREFIX = "linear."
REGION = SHEET_COLUMNS
"""Vertices of a region, a row of the sheet."""
RANK = PREFIX + "rank"
MAX_BASES = 128
MAX_DIRECTIONS = 8192
"""Directions of all regions (chosen: seven times what the shipped heads have; 6 MB in a file)."""


def linear_shapes(
    shapes: Mapping[str, tuple[int, ...]], num_vertices: int
) -> dict[str, tuple[int, ...]]:
    """Shapes that the ``linear.*`` tensors of a file must have, by those that it has; ValueError if
    a number of bases or directions is out of its limits."""
    mix = (*shapes.get(f"{PREFIX}mix", ()), 0, 0)
    for what, count, limit in (("rows", mix[0], MAX_DIRECTIONS), ("columns", mix[1], MAX_BASES)):
        if not 1 <= count <= limit:
            raise ValueError(f"tensor linear.mix has {count} {what}; allowed are 1 to {limit}")
    directions, count, rows = mix[0], mix[1], -(-num_vertices // REGION)
    return {
        f"{PREFIX}weight": (count, NUM_LATENT),
        f"{PREFIX}bias": (count,),
        f"{PREFIX}mix": (directions, count),
        f"{PREFIX}basis": (directions, REGION, POSITION_CHANNELS),
        f"{PREFIX}mean": (rows, REGION, POSITION_CHANNELS),
        RANK: (rows,),
    }


def check_linear(tensors: Mapping[str, Array]) -> None:
    """Raise a ValueError for a rank below 0 or above the number of weights, or if ranks do not add
    up to the directions; names and shapes fit already."""
    rank, (directions, count) = tensors[RANK], tensors[f"{PREFIX}mix"].shape
    if rank.min() < 0 or rank.max() > count:
        raise ValueError(
            f"tensor {RANK} has ranks {rank.min()} to {rank.max()}; allowed are 0 to {count}"
        )
    if (total := int(rank.sum(dtype=np.int64))) != directions:
        raise ValueError(f"tensor {RANK} adds up to {total}; linear.mix has {directions} rows")


def weights_of_latent(tensors: Mapping[str, Array], latent: Array) -> Array:
    """Latents ``[..., 8, 8, 4]`` to the weights of the whole ``[..., K]``, float64."""
    flat = np.asarray(latent, np.float64).reshape(*latent.shape[:-3], NUM_LATENT)
    found: Array = flat @ tensors[f"{PREFIX}weight"].astype(np.float64).T
    return found + tensors[f"{PREFIX}bias"]


def components_of(
    tensors: Mapping[str, Array], scale_m: float, vertices: IntArray | None = None
) -> FloatArray:
    """What a unit of each weight moves, regions put together again, metres: float32 ``[K, V, 3]``
    of the vertices with these numbers, or of all places of the sheet."""
    mix, basis = tensors[f"{PREFIX}mix"], tensors[f"{PREFIX}basis"]
    ends = np.cumsum(tensors[RANK])
    starts = ends - tensors[RANK]
    whole = np.zeros((len(starts), REGION, POSITION_CHANNELS, mix.shape[1]), np.float32)
    for row, (start, end) in enumerate(zip(starts, ends, strict=True)):
        whole[row] = np.tensordot(basis[start:end], scale_m * mix[start:end], axes=(0, 0))
    flat = whole.reshape(-1, POSITION_CHANNELS, mix.shape[1])
    chosen = flat if vertices is None else flat[vertices]
    return np.ascontiguousarray(chosen.transpose(2, 0, 1), np.float32)
