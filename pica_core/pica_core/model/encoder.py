"""Encoders: average texture and tracked mesh of a moment to the latent's mean and log-variance.

`PaperEncoder` is the paper's, to the letter of appendix A.1: 161.7 G multiply-adds a frame, 137 of
them in its second convolution. `LightEncoder` is ours: it looks at a 256 x 256 texture and costs
0.04 G, for training without a GPU. Neither is needed at run time.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from pica_core.avatar.spec import LEAKY_SLOPE
from pica_core.latent import LATENT_CHANNELS
from pica_core.model.interface import LatentEncoder

MAX_LOG_VARIANCE = 4.0
"""A deviation of 7, against the prior's 1; trained encoders say -3 on average, 0 at most."""


def _halving(channels: Sequence[int]) -> nn.Sequential:
    """Convolutions 4x4 of stride 2 with LeakyReLU, each halving the resolution."""
    steps: list[nn.Module] = []
    for c_in, c_out in pairwise(channels):
        steps += [nn.Conv2d(c_in, c_out, 4, stride=2, padding=1), nn.LeakyReLU(LEAKY_SLOPE)]
    return nn.Sequential(*steps)


class _GridEncoder(LatentEncoder):
    """Two heads, a joint trunk down to 8 x 8, and 1x1 convolutions for mean and log-variance."""

    def __init__(self, tex_head: nn.Module, geom_head: nn.Module, trunk: Sequence[int]) -> None:
        super().__init__()
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


class PaperEncoder(_GridEncoder):
    """The paper's encoder; textures are 1024 x 1024."""

    texture_size = 1024

    def __init__(self) -> None:
        geom_head = nn.Sequential(nn.Conv2d(3, 256, 1), nn.LeakyReLU(LEAKY_SLOPE))
        super().__init__(_halving([3, 512, 256]), geom_head, [512, 128, 64, 32, 16, 8])


class LightEncoder(_GridEncoder):
    """A narrow encoder for training on a CPU; textures are 256 x 256."""

    texture_size = 256

    def __init__(self) -> None:
        geom_head = nn.Sequential(nn.AvgPool2d(2), *_halving([3, 12]))
        super().__init__(_halving([3, 8, 16]), geom_head, [28, 32, 48, 64])


ENCODERS: dict[str, type[PaperEncoder | LightEncoder]] = {
    "paper": PaperEncoder,
    "light": LightEncoder,
}


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
