"""What choices cost in error, in the form in which a scheduler can ask thousands of times. Pure.

`LevelErrors` of an avatar is a measured table and need not be well behaved. Here it becomes one in
which more is never worse and nearer is never less: what the maps of a level leave over those of the
next finer one, and what its mesh leaves, falls nowhere as the head grows on the screen. Where the
table says otherwise the larger of its values holds, so an estimate errs towards spending more.

    errors = ErrorModel(avatar.level_errors or default_errors(avatar.levels))
    maps, meshes, own = errors.extra(head_px)       # MSE; no numpy, a few us
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pica_core.avatar.levels import LevelErrors


class Extra(NamedTuple):
    """What is left by what a head gets, MSE. Maps and mesh add up."""

    maps: list[float]
    """Of each level's, over the full ones on the same mesh; the last is 0."""
    meshes: list[float]
    """Of each level's, over the full one with the full maps; the last is 0."""
    own: float
    """Of the full level, against many samples a pixel."""


class ErrorModel:
    """The errors of one avatar's levels.

    Attributes:
        levels: Ascending; the full one last.
        view_mse_per_rad2: MSE of an expression map kept while the view turns, per square radian.
        latent_mse_per_unit2: MSE of maps kept while the latent moves, per squared RMS distance.
    """

    def __init__(self, table: LevelErrors) -> None:
        """Prepare.

        Args:
            table: As the avatar file gives it, or a guess.
        """
        self.levels = table.levels
        self.view_mse_per_rad2 = float(table.view_mse_per_rad2)
        self.latent_mse_per_unit2 = float(table.latent_mse_per_unit2)
        self._octaves = np.log2(table.head_px.astype(np.float64)).tolist()
        mse = table.mse.astype(np.float64)
        own, on_full_maps = mse[:, 0], mse[:, 1]
        # Per height of the table: the maps of each level, the mesh of each level, the rest.
        self._rows: list[list[float]] = np.concatenate(
            [_over_full(own - on_full_maps), _over_full(on_full_maps), own[-1:]]
        ).T.tolist()

    def extra(self, head_px: float) -> Extra:
        """What choices leave, for a head of this height on the screen.

        Returns:
            See `Extra`. Straight over the logarithm of the height between the table's entries;
            beyond them the nearest holds.
        """
        values, count = self._values(head_px), len(self.levels)
        return Extra(values[:count], values[count:-1], values[-1])

    def _values(self, head_px: float) -> list[float]:
        octaves, rows = self._octaves, self._rows
        octave = math.log2(head_px) if head_px > 0 else -math.inf
        place = bisect_right(octaves, octave)
        if place == 0:
            return rows[0]
        if place == len(octaves):
            return rows[-1]
        weight = (octave - octaves[place - 1]) / (octaves[place] - octaves[place - 1])
        before, after = rows[place - 1], rows[place]
        return [low + weight * (high - low) for low, high in zip(before, after, strict=True)]


def _over_full(mse: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """How much each row ``[L, K]`` is above the last: nowhere less than the next, nowhere falling
    along K, and neither are the differences of neighbours."""
    steps = np.maximum(mse[:-1] - mse[1:], 0)
    rising = np.maximum.accumulate(steps, axis=1)
    above: npt.NDArray[np.float64] = np.concatenate(
        [np.cumsum(rising[::-1], axis=0)[::-1], np.zeros((1, mse.shape[1]))]
    )
    return above
