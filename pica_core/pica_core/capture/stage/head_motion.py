"""Small motion of the head on the stage, which the cameras do not follow."""

import numpy as np
from scipy.spatial.transform import Rotation

from pica_core.capture.stage.waves import smooth_signals
from pica_core.types import Float64Array

TURN_DEG = (2.5, 3.5, 1.5)
"""Standard deviations of nodding, turning and tilting, degrees (chosen: a seated speaker)."""
SHIFT_M = (0.006, 0.003, 0.006)
"""Standard deviations along x, y and z, metres (chosen)."""
SCALE_S = 0.9
"""Time over which the head moves."""
PIVOT_M = (0.0, -0.09, -0.015)
"""What the head turns about: the top of the neck, head frame."""
LIMIT = 2.0
"""Signals are held within so many standard deviations."""


def head_to_world(seed: int, take: int, time_s: float) -> Float64Array:
    """A head's pose in a take of a capture, by the capture's seed and the take's number.

    Returns:
        Rotation and translation (metres) from head frame to world. float64 ``[3, 4]``.
    """
    random = np.random.default_rng([seed, 0x4EAD, take])
    values = LIMIT * np.tanh(smooth_signals(random, 6, SCALE_S, time_s) / LIMIT)
    rotation = Rotation.from_rotvec(np.radians(TURN_DEG) * values[:3]).as_matrix()
    pivot = np.array(PIVOT_M)
    shift = pivot - rotation @ pivot + SHIFT_M * values[3:]
    return np.concatenate([rotation, shift[:, None]], axis=1)
