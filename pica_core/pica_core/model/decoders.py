"""The per-object decoders in torch: `decoder_layers` turned into modules.

Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), section 3 and appendix A.1. The block is our
choice by name (`AvatarSpec.block`), because the paper's Fig. 3b is not in its text.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from pica_core.avatar.spec import LEAKY_SLOPE, AvatarSpec, Layer, decoder_layers
from pica_core.latent import LATENT_SIZE
from pica_core.model.interface import Surface


class Untied(nn.Module):
    """A bias (Lombardi et al. 2018) or a factor per channel and location, ``[C, H, W]``; 0 or 1 at
    first."""

    def __init__(self, channels: int, size: int, *, is_gain: bool = False) -> None:
        super().__init__()
        self._is_gain = is_gain
        self.weight = nn.Parameter(torch.full((channels, size, size), float(is_gain)))

    def forward(self, features: Tensor) -> Tensor:
        """Features ``[N, C, H, W]`` with the bias added, or times the factors."""
        return features * self.weight if self._is_gain else features + self.weight


def _module(layer: Layer) -> nn.Module:
    channels, bias = (layer.in_channels, layer.out_channels), layer.has_bias
    match layer.kind:
        case "conv3":
            return nn.Conv2d(*channels, 3, padding=1, bias=bias)
        case "conv1":
            return nn.Conv2d(*channels, 1, bias=bias)
        case "deconv4":
            return nn.ConvTranspose2d(*channels, 4, stride=2, padding=1, bias=bias)
        case "untied_bias" | "untied_gain":
            is_gain = layer.kind == "untied_gain"
            return Untied(layer.out_channels, layer.size, is_gain=is_gain)
        case "leaky_relu":
            return nn.LeakyReLU(LEAKY_SLOPE)
        case "pixel_shuffle":
            return nn.PixelShuffle(2)


class MapDecoder(nn.Module):
    """A decoder: ``[N, C, 8, 8]`` to ``[N, C', 256, 256]``.

    Weights start with He's variance for leaky units (gain over the inputs of one output), and the
    last convolution a hundred times smaller, so that training begins at the mean face.
    """

    def __init__(self, spec: AvatarSpec, decoder: str) -> None:
        super().__init__()
        self.layers = decoder_layers(spec, decoder)
        self.steps = nn.ModuleList(_module(layer) for layer in self.layers)
        convolutions = [
            step for step in self.steps if isinstance(step, nn.Conv2d | nn.ConvTranspose2d)
        ]
        for step in convolutions:
            taps = 4 if isinstance(step, nn.ConvTranspose2d) else step.weight[0, 0].numel()
            gain = (2 / (1 + LEAKY_SLOPE**2)) ** 0.5
            nn.init.normal_(step.weight, std=gain / (taps * step.in_channels) ** 0.5)
            if step.bias is not None:
                nn.init.zeros_(step.bias)
        with torch.no_grad():
            convolutions[-1].weight.mul_(0.01)

    def forward(self, grid: Tensor) -> Tensor:
        """``[N, C, 8, 8]`` to ``[N, C', 256, 256]``."""
        for step in self.steps:
            grid = step(grid)
        return grid

    def named_tensors(self) -> dict[str, Tensor]:
        """The weights under their names in the avatar file."""
        return {
            name: getattr(step, name.rsplit(".", 1)[1])
            for layer, step in zip(self.layers, self.steps, strict=True)
            for name in layer.tensor_shapes()
        }


def tile_view_direction(view_direction: Tensor) -> Tensor:
    """View directions ``[N, 3]`` tiled over the latent's grid, ``[N, 3, 8, 8]``."""
    return view_direction[:, :, None, None].expand(-1, -1, LATENT_SIZE, LATENT_SIZE)


def sample_map(values: Tensor, uv: Tensor) -> Tensor:
    """Look maps up at UV points, bilinear, texel centres at (i + 0.5) / W, clamped at the edge:
    ``[N, P, C]``.

    Args:
        values: ``[N, C, H, W]``.
        uv: Points in [0, 1], ``[N, P, 2]``, or ``[P, 2]`` for the same points in every map.
    """
    if uv.ndim == 2:
        uv = uv.expand(len(values), -1, -1)
    sampled = functional.grid_sample(
        values, 2 * uv[:, None] - 1, mode="bilinear", padding_mode="border", align_corners=False
    )
    return sampled[:, :, 0].transpose(1, 2)


def sample_per_image(maps: Tensor, surface: Surface) -> Tensor:
    """Look every pixel of a surface, sorted by image, up in the map of its own image.

    Maps are ``[N, C, H, W]``, what is found ``[P, C]``.
    """
    counts = torch.bincount(surface.image, minlength=len(maps))
    parts = torch.split(surface.uv, counts.tolist())
    return torch.cat([sample_map(maps[index : index + 1], uv)[0] for index, uv in enumerate(parts)])
