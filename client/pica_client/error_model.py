"""What choices cost in error, in the form in which a scheduler can ask thousands of times. Pure.

`LevelErrors` of an avatar is a measured table and need not be well behaved. Here it becomes one in
which more is never worse and nearer is never less: the *extra* error of each level over the next
finer one, and of coarse shading over fine, falls nowhere as the head grows on the screen. Where the
table says otherwise the larger of its values holds, so an estimate errs towards spending more.

    errors = ErrorModel(avatar.level_errors or default_errors(avatar.levels))
    extra = errors.extra(head_px)          # per level, then coarse shading; no numpy, a few us
"""

from __future__ import annotations

import math
from bisect import bisect_right

import numpy as np

from pica_core.levels import LevelErrors


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
        fine, coarse = mse[:, 0], mse[:, 1]
        steps = np.maximum(fine[:-1] - fine[1:], 0)
        half = np.maximum((coarse - fine).max(axis=0), 0)
        rising = np.maximum.accumulate(np.concatenate([steps, half[None]]), axis=1)
        over_full = np.concatenate(
            [np.cumsum(rising[-2::-1], axis=0)[::-1], np.zeros((1, rising.shape[1]))]
        )
        # Per height of the table: error of each level over the full one, coarse shading, the rest.
        self._rows: list[list[float]] = np.concatenate(
            [over_full, rising[-1:], fine[-1:]]
        ).T.tolist()

    def extra(self, head_px: float) -> list[float]:
        """What choices leave, for a head of this height on the screen.

        Returns:
            MSE of each level over the full one (the last is 0), then of shading at half the
            resolution over full, then of the full level at full resolution. Straight over the
            logarithm of the height between the table's entries; beyond them the nearest holds.
        """
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
