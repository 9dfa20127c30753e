"""Levels of detail: which maps an avatar can be decoded to, and what each of them costs in error.

A *level* is the size of the decoded expression map in texels per side. The full one is the model
itself. A level below it is an early exit of both decoders: the trunk is left after the block that
makes maps of that size, and one linear layer turns what is there into

    expression map = conv3x3(trunk) + bias                       a bias per texel, [S, S, 4]
    vertices       = mean + position_scale_m * (weight . trunk)  weights per vertex, in a sheet

The vertices are those of the level's own mesh: coarser triangles over some of the same vertices.
Each is made of the two texels of the trunk that are nearest to it. A position map of that size
would not do: lids and lips lie closer together than its texels, and with one convolution for all
of it eyes and lips do not follow (vertices 0.27 mm off on average in a face that moves by 0.86;
0.05 mm like this). The mesh of a level can also be drawn with the full maps.

An avatar may have exits at a quarter and a half of its full map: 64 and 128 of 256.
"""

from dataclasses import dataclass

import numpy as np

from pica_core.avatar.spec import AvatarSpec
from pica_core.latent import LATENT_SIZE
from pica_core.types import FloatArray

NUM_DRAWINGS = 2
"""Ways to draw the mesh of a level: with what the level makes, and with the full maps."""
EXIT_DIVISORS = (4, 2)
"""Full map size over the size of each possible exit (chosen: the two last blocks are where the
work of a decoder is)."""
LEAST_MSE = 1e-6
"""Errors below count as this one: their logarithm is needed."""
SENSITIVITY_HEAD_PX = 512.0
"""Height of the head at which the two sensitivities were measured, pixels."""

JUDGED = ("eyes", "mouth", "rest", "poke")
"""Columns of a table of judgements: MSE 0-255 of what people look at most, of the rest, and the
ratio of the head's pixels that show another piece of it than they should."""
GAZE = (0.4, 0.3, 0.3)
"""How much of their time people look at eyes, mouth and the rest of a face that talks (chosen)."""
POKE_MSE = 2e4
"""What the ratio of poking pixels counts as: 0.05 % like an MSE of 10 (chosen)."""


def judged_mse(row: FloatArray) -> FloatArray:
    """Judgements ``[..., 4]`` as one error each, by `GAZE` and `POKE_MSE`."""
    found: FloatArray = row @ np.array([*GAZE, POKE_MSE], np.float32)
    return found


def level_sizes(spec: AvatarSpec) -> tuple[int, ...]:
    """Every level that an avatar of this spec may have, ascending; the full map is the last."""
    sizes = [spec.map_size // divisor for divisor in EXIT_DIVISORS]
    return (*(size for size in sizes if size > LATENT_SIZE), spec.map_size)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelErrors:
    """The rendered error that levels leave, by the size of the head on screen.

    Errors are mean squared differences on 0-255 values over the head's pixels, against the full
    level drawn with supersampling. Names and shapes are checked with the file's.
    """

    levels: tuple[int, ...]
    """The avatar's levels, ascending, length L."""
    head_px: FloatArray
    """Heights of the head's bounding box on screen, pixels, ascending. float32 ``[K]``."""
    mse: FloatArray
    """Per level, of its own maps and mesh, and of the full maps drawn with its mesh; and height.
    float32 ``[L, 2, K]``; the full level's two are the same."""
    view_mse_per_rad2: float
    """What an expression map costs that is kept while the view turns: MSE per square radian, at
    `SENSITIVITY_HEAD_PX`."""
    latent_mse_per_unit2: float
    """What maps cost that are kept while the latent moves: MSE per squared RMS distance of latents,
    at `SENSITIVITY_HEAD_PX`."""

    def __post_init__(self) -> None:
        heights = self.head_px
        if not ((np.diff(heights) > 0).all() and heights[0] > 0 and np.isfinite(heights[-1])):
            raise ValueError("head_px must be one or more heights above 0, finite and ascending")
        sensitivities = (self.view_mse_per_rad2, self.latent_mse_per_unit2)
        for name, values in (("errors", self.mse), ("sensitivity", np.array(sensitivities))):
            if not (np.isfinite(values).all() and values.min() >= 0):
                raise ValueError(f"{name} must be finite and at least 0")

    def at(self, level: int, head_px: float, *, full_maps: bool = False) -> float:
        """The MSE of a level, or of the full maps on its mesh, at a height of the head in pixels.

        Between the table's heights its logarithm runs straight over the logarithm of the height;
        beyond them the nearest entry holds.

        Raises:
            ValueError: An unknown level.
        """
        if level not in self.levels:
            raise ValueError(f"level {level}; known are {', '.join(map(str, self.levels))}")
        row = self.mse[self.levels.index(level), int(full_maps)]
        height = float(np.clip(head_px, self.head_px[0], self.head_px[-1]))
        known = np.log(np.maximum(row, LEAST_MSE))
        return float(np.exp(np.interp(np.log(height), np.log(self.head_px), known)))
