"""The whole model: latent to position map, expression map and pixel colours.

Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), section 3.

Our choices: the position map is the mean map plus `position_scale_m` times the decoder's output
(positions normalised by mean and deviation, as face captures are published), and the block of
the decoders is a setting.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from pica_core.arkit import NUM_ARKIT
from pica_core.model.decoders import MapDecoder, sample_map, tile_view_direction
from pica_core.model.encoder import make_encoder
from pica_core.model.pixel_decoder import FIRST_FREQUENCY, PixelDecoder
from pica_core.spec import LATENT_CHANNELS, LATENT_SIZE, LEAKY_SLOPE, NUM_LATENT, AvatarSpec


class Surface(NamedTuple):
    """What rasterisation finds at P pixels of N images.

    Attributes:
        image: Which image a pixel belongs to, int64 ``[P]``.
        uv: Surface coordinates, ``[P, 2]``.
        xyz_m: Head-frame positions in metres, ``[P, 3]``.
    """

    image: Tensor
    uv: Tensor
    xyz_m: Tensor


class ExpressionEncoder(nn.Module):
    """52 ARKit values to the latent: the sender's encoder, small enough for any CPU (ours)."""

    def __init__(self, hidden: tuple[int, ...] = (160, 160)) -> None:
        super().__init__()
        widths = (NUM_ARKIT, *hidden, NUM_LATENT)
        self.layers = nn.ModuleList(nn.Linear(n, m) for n, m in pairwise(widths))

    def forward(self, arkit: Tensor) -> Tensor:
        """Expressions ``[N, 52]`` to latents ``[N, 4, 8, 8]``; flat: row, column, channel."""
        values = arkit
        for index, layer in enumerate(self.layers):
            values = layer(values)
            if index + 1 < len(self.layers):
                values = nn.functional.leaky_relu(values, LEAKY_SLOPE)
        grid = values.view(-1, LATENT_SIZE, LATENT_SIZE, LATENT_CHANNELS)
        return grid.permute(0, 3, 1, 2)


class PixelCodecAvatar(nn.Module):
    """Encoder, decoders and pixel decoder of one person.

    Args:
        spec: Sizes and block.
        position_mean: Mean position map in metres, float32 ``[256, 256, 3]``.
        position_scale_m: Unit of the geometry decoder's output, metres.
        encoder: "paper" or "light".
        encoding_amplitude: Half-width of the encodings' uniform start (paper: 1).
        first_frequency: Scale of the first sine layers.
    """

    position_mean: Tensor

    def __init__(
        self,
        spec: AvatarSpec,
        position_mean: np.ndarray[tuple[int, ...], np.dtype[np.float32]],
        position_scale_m: float,
        *,
        encoder: str = "light",
        encoding_amplitude: float = 1.0,
        first_frequency: float = FIRST_FREQUENCY,
    ) -> None:
        super().__init__()
        self.spec = spec
        self.position_scale_m = position_scale_m
        mean = torch.as_tensor(position_mean, dtype=torch.float32).permute(2, 0, 1)
        self.register_buffer("position_mean", mean.contiguous())
        self.encoder = make_encoder(encoder)
        self.geometry = MapDecoder(spec, "geometry")
        self.expression = MapDecoder(spec, "expression")
        self.pixel_decoder = PixelDecoder(
            spec, encoding_amplitude=encoding_amplitude, first_frequency=first_frequency
        )
        self.expression_encoder = ExpressionEncoder()

    def decode_geometry(self, latent: Tensor) -> Tensor:
        """Latents ``[N, 4, 8, 8]`` to position maps in metres ``[N, 3, 256, 256]``."""
        offset: Tensor = self.geometry(latent)
        return self.position_mean + self.position_scale_m * offset

    def decode_expression(self, latent: Tensor, view_direction: Tensor) -> Tensor:
        """Latents ``[N, 4, 8, 8]`` and view directions ``[N, 3]`` to ``[N, 4, 256, 256]``."""
        grid = torch.cat([latent, tile_view_direction(view_direction)], 1)
        codes: Tensor = self.expression(grid)
        return codes

    def shade(self, expression_map: Tensor, surface: Surface, *, detach_xyz: bool = True) -> Tensor:
        """Colours of the pixels of `surface`, ``[P, 3]``.

        Args:
            expression_map: ``[N, 4, 256, 256]``.
            surface: Pixels sorted by image.
            detach_xyz: Stop the gradient from the colour to the geometry through the pixel
                decoder's xyz input. The paper needs it for stable training (appendix A.3); the
                other path, through rasterisation to uv, stays open.
        """
        counts = torch.bincount(surface.image, minlength=len(expression_map))
        parts = torch.split(surface.uv, counts.tolist())
        codes = torch.cat(
            [sample_map(expression_map[index : index + 1], uv)[0] for index, uv in enumerate(parts)]
        )
        xyz_m = surface.xyz_m.detach() if detach_xyz else surface.xyz_m
        colours: Tensor = self.pixel_decoder(codes, xyz_m, surface.uv)
        return colours
