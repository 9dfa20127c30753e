"""The encoder, and the per-object decoders: `decoder_layers` turned into modules.

Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), section 3 and appendix A.1. The decoders'
block is our choice by name (`AvatarSpec.block`), because the paper's Fig. 3b is not in its text.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from pica_core.avatar.spec import LEAKY_SLOPE, AvatarSpec, Layer, decoder_layers
from pica_core.model.interface import LatentEncoder
from pica_core.types import LATENT_CHANNELS, LATENT_SIZE


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


class Shuffled(nn.Conv2d):
    """A convolution 1x1 and the pixel shuffle behind it, as one transposed convolution: the same
    numbers, and channels stay last; on one thread of a CPU half of the time."""

    def forward(self, features: Tensor) -> Tensor:
        """``[N, C, S, S]`` to ``[N, C', 2 S, 2 S]``."""
        count, _, size, _ = features.shape
        assert self.bias is not None
        weight = self.weight.view(-1, 2, 2, self.in_channels).permute(3, 0, 1, 2)
        found = functional.conv_transpose2d(features, weight, stride=2).permute(0, 2, 3, 1)
        # The biases of two rows of texels, as long as rows are.
        biases = self.bias.view(-1, 2, 2).permute(1, 2, 0)[:, None].expand(2, size, 2, -1)
        rows = found.reshape(count * size, 2, -1) + biases.reshape(2, -1)
        return rows.view(found.shape).permute(0, 3, 1, 2)


def _module(layer: Layer) -> nn.Module:
    channels, bias = (layer.in_channels, layer.out_channels), layer.has_bias
    match layer.kind:
        case "conv3":
            return nn.Conv2d(*channels, 3, padding=1, bias=bias)
        case "conv1":
            return Shuffled(*channels, 1, bias=bias)
        case "deconv4":
            return nn.ConvTranspose2d(*channels, 4, stride=2, padding=1, bias=bias)
        case "untied_bias" | "untied_gain":
            is_gain = layer.kind == "untied_gain"
            return Untied(layer.out_channels, layer.size, is_gain=is_gain)
        case "leaky_relu":
            return nn.LeakyReLU(LEAKY_SLOPE)
        case "pixel_shuffle":
            return nn.Identity()  # `Shuffled` did it


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


MAX_LOG_VARIANCE = 4.0
"""A deviation of 7, against the prior's 1; trained encoders say -3 on average, 0 at most."""


class MeanOfFour(nn.Module):
    """Average pooling 2x2; on a CPU torch's own takes six times as long."""

    def forward(self, values: Tensor) -> Tensor:
        """``[N, C, 2 S, 2 S]`` to ``[N, C, S, S]``."""
        rows = values[:, :, ::2] + values[:, :, 1::2]
        return 0.25 * (rows[..., ::2] + rows[..., 1::2])


def _halving(channels: Sequence[int]) -> nn.Sequential:
    """Convolutions 4x4 of stride 2 with LeakyReLU, each halving the resolution."""
    steps: list[nn.Module] = []
    for c_in, c_out in pairwise(channels):
        steps += [nn.Conv2d(c_in, c_out, 4, stride=2, padding=1), nn.LeakyReLU(LEAKY_SLOPE)]
    return nn.Sequential(*steps)


class GridEncoder(LatentEncoder):
    """Two heads, a joint trunk down to 8 x 8, and 1x1 convolutions for mean and log-variance."""

    def __init__(
        self, texture_size: int, geom_head: nn.Module, tex_head: nn.Module, trunk: Sequence[int]
    ) -> None:
        super().__init__()
        self.texture_size = texture_size
        self.tex_head = tex_head
        self.geom_head = geom_head
        self.trunk = _halving(trunk)
        self.mean = nn.Conv2d(trunk[-1], LATENT_CHANNELS, 1)
        self.log_variance = nn.Conv2d(trunk[-1], LATENT_CHANNELS, 1)
        with torch.no_grad():
            self.log_variance.weight.mul_(0.1)

    def forward(self, texture: Tensor, position_map: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log-variance of the latent."""
        heads = [self.tex_head(texture), self.geom_head(position_map)]
        joint = self.trunk(torch.cat(heads, 1))
        return self.mean(joint), self.log_variance(joint)


ENCODERS: dict[str, Callable[[], GridEncoder]] = {
    "paper": lambda: GridEncoder(
        1024,
        nn.Sequential(nn.Conv2d(3, 256, 1), nn.LeakyReLU(LEAKY_SLOPE)),
        _halving([3, 512, 256]),
        [512, 128, 64, 32, 16, 8],
    ),
    "light": lambda: GridEncoder(
        256,
        nn.Sequential(MeanOfFour(), *_halving([3, 12])),
        _halving([3, 8, 16]),
        [28, 32, 48, 64],
    ),
}
"""The paper's encoder, and a narrow one for training on a CPU."""


def hold_log_variance(log_variance: Tensor) -> Tensor:
    """Bend log-variances so that none exceeds `MAX_LOG_VARIANCE`; well below they stay as they are.

    Of a frame that is unlike the others an encoder may say 60 of a sudden; its exponential and the
    gradient of that are not numbers any more.
    """
    return MAX_LOG_VARIANCE - functional.softplus(MAX_LOG_VARIANCE - log_variance)


def reparameterise(mean: Tensor, log_variance: Tensor, noise: Tensor) -> Tensor:
    """A sample of the latent: mean + exp(log_variance / 2) noise; `noise` is standard normal."""
    return mean + (0.5 * log_variance).exp() * noise


def resize_texture(texture: Tensor, size: int) -> Tensor:
    """Bring textures ``[N, 3, S, S]`` to the encoder's size by area averaging or bilinear."""
    if texture.shape[-1] == size:
        return texture
    if texture.shape[-1] > size:
        return functional.interpolate(texture, size=(size, size), mode="area")
    return functional.interpolate(texture, size=(size, size), mode="bilinear", align_corners=False)
