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

import numpy as np

from pica_core.avatar.spec import AvatarSpec
from pica_core.latent import LATENT_SIZE
from pica_core.types import FloatArray

NUM_DRAWINGS = 2
"""Ways to draw the mesh of a level: with what the level makes, and with the full maps."""
EXIT_DIVISORS = (4, 2)
"""Full map size over the size of each possible exit (chosen: the two last blocks are where the
work of a decoder is)."""
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
