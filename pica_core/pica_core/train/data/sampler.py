"""Which frames a step is trained on: rare expressions are drawn more often."""

import numpy as np

from pica_core.train.data.meshes import IMPORTANT_REGIONS
from pica_core.types import BoolArray, Float64Array, FloatArray

MAX_RARITY = 8.0
"""Limit of a frame's weight against the usual one (chosen: a full blink reaches 7)."""


def rarity(offsets_m: FloatArray, regions: dict[str, BoolArray]) -> Float64Array:
    """How far each frame's eyes or mouth lie from their mean, against the usual.

    Args:
        offsets_m: Vertices minus mean vertices, metres, ``[T, V, 3]``.
        regions: Named vertex sets, bool ``[V]`` each.

    Returns:
        The largest such ratio over `IMPORTANT_REGIONS`, from 1 to `MAX_RARITY`, float64 ``[T]``.
    """
    ratios = np.ones(len(offsets_m))
    for name in IMPORTANT_REGIONS:
        if name not in regions or not regions[name].any():
            continue
        part = offsets_m[:, regions[name]]
        distance = np.sqrt(np.square(part, dtype=np.float64).sum(2).mean(1))
        ratios = np.maximum(ratios, distance / max(float(distance.mean()), 1e-9))
    return np.minimum(ratios, MAX_RARITY)


def spaced(frames: list[int], count: int) -> list[int]:
    """At most `count` of some frames, evenly spaced."""
    return frames[:: -(-len(frames) // count)] if count else []
