"""Smooth random functions of place and time that need no state: sums of a few random waves.

Any moment can be asked for by itself, so a render that is resumed gives what an uninterrupted one
gives.
"""

import numpy as np
import numpy.typing as npt

from pica_core.types import Float64Array


class TimeWaves:
    """Independent smooth signals of about unit variance, which change over `scale_s` seconds.

    One wave per signal is a sine, many are near a Gaussian process.
    """

    def __init__(
        self, random: np.random.Generator, count: int, scale_s: float, waves: int = 3
    ) -> None:
        self._frequency = random.normal(0.0, 1.0 / scale_s, (waves, count))
        self._phase = random.uniform(0.0, 2 * np.pi, (waves, count))

    def at(self, time_s: float) -> Float64Array:
        """The signals at a moment. float64 ``[count]``."""
        waves = np.cos(self._frequency * time_s + self._phase)
        return waves.sum(axis=0) * np.sqrt(2.0 / len(waves))


class SpaceTimeWaves:
    """A smooth vector field on points ``[V, 3]`` that changes over `scale_m` and with time."""

    def __init__(
        self, random: np.random.Generator, points_m: npt.ArrayLike, scale_m: float, waves: int = 48
    ) -> None:
        points = np.asarray(points_m, np.float64)
        direction = random.normal(0.0, 1.0 / scale_m, (3, waves))
        phase = random.uniform(0.0, 2 * np.pi, waves)
        self._basis = np.sqrt(2.0 / waves) * np.cos(points @ direction + phase)
        self.waves = waves

    def mix(self, strengths: Float64Array) -> Float64Array:
        """The field for given strengths ``[waves * 3]`` of unit variance. float64 ``[V, 3]``."""
        return self._basis @ strengths.reshape(self.waves, 3)
