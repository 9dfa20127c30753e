"""Smooth random functions of place and time that need no state: sums of a few random waves.

Any moment can be asked for by itself, so a render that is resumed gives what an uninterrupted one
gives.
"""

import numpy as np
import numpy.typing as npt

from pica_core.types import Float64Array

WAVES = 3
"""Waves in a signal: one is a sine, many are near a Gaussian process."""
FIELD_WAVES = 48


def smooth_signals(
    random: np.random.Generator, count: int, scale_s: float, time_s: float
) -> Float64Array:
    """Signals of about unit variance, which change over `scale_s`, at a moment. ``[count]``."""
    frequency = random.normal(0.0, 1.0 / scale_s, (WAVES, count))
    phase = random.uniform(0.0, 2 * np.pi, (WAVES, count))
    return np.cos(frequency * time_s + phase).sum(axis=0) * np.sqrt(2.0 / WAVES)


def smooth_field(
    random: np.random.Generator, points_m: npt.NDArray[np.floating], scale_m: float
) -> Float64Array:
    """Weights at points ``[V, 3]`` of `FIELD_WAVES` strengths of unit variance, whose sum changes
    over `scale_m`. float64 ``[V, 48]``."""
    direction = random.normal(0.0, 1.0 / scale_m, (3, FIELD_WAVES))
    phase = random.uniform(0.0, 2 * np.pi, FIELD_WAVES)
    return np.sqrt(2.0 / FIELD_WAVES) * np.cos(points_m.astype(np.float64) @ direction + phase)
