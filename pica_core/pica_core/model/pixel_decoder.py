"""The pixel decoder: two small sine networks over expression, position and surface encoding.

Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), sections 3 and 4 and appendix A.1; sine
networks and their initialisation: Sitzmann et al., "Implicit Neural Representations with Periodic
Activation Functions" (2020), with the frequency folded into the weights, so that a layer is
sin(W x + b) and nothing else, in torch, in the avatar file and in GLSL.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from pica_core.avatar.spec import AvatarSpec
from pica_core.model.encodings import SurfaceEncoding, make_encoding

XYZ_UNIT_M = 0.1
"""Head-frame coordinates enter the network in this unit, which brings a face to about [-1, 1]."""
FIRST_FREQUENCY = 6.0
"""Scale of the first layer's weights (chosen: 30, as in Sitzmann et al. for whole images, makes
noise here, because the learned encodings already carry the detail)."""


class Siren(nn.Module):
    """Layers sin(W x + b); the last one linear if `linear_output`."""

    def __init__(
        self,
        in_channels: int,
        out_channels: Sequence[int],
        *,
        linear_output: bool,
        first_frequency: float = FIRST_FREQUENCY,
    ) -> None:
        super().__init__()
        self.linear_output = linear_output
        self.layers = nn.ModuleList()
        for index, width in enumerate(out_channels):
            layer = nn.Linear(in_channels, width)
            bound = first_frequency / in_channels if index == 0 else math.sqrt(6 / in_channels)
            if linear_output and index + 1 == len(out_channels):
                bound = math.sqrt(6 / in_channels) / FIRST_FREQUENCY
            nn.init.uniform_(layer.weight, -bound, bound)
            nn.init.uniform_(layer.bias, -math.pi, math.pi)
            self.layers.append(layer)
            in_channels = width
        if linear_output:
            nn.init.constant_(layer.bias, 0.5)

    def forward(self, values: Tensor) -> Tensor:
        """``[P, in]`` to ``[P, out]``."""
        last = len(self.layers) - 1
        for index, layer in enumerate(self.layers):
            values = layer(values)
            if index < last or not self.linear_output:
                values = torch.sin(values)
        return values

    def named_tensors(self, prefix: str) -> dict[str, Tensor]:
        """Weights and biases as ``{prefix}.{i}.weight`` and ``{prefix}.{i}.bias``."""
        return {
            f"{prefix}.{index}.{kind}": getattr(layer, kind)
            for index, layer in enumerate(self.layers)
            for kind in ("weight", "bias")
        }


class PixelDecoder(nn.Module):
    """f: expression code, head-frame position and surface point of a pixel to its colour.

    In the paper's sizes 307 parameters in `colour`, 36 in `xyz`, the rest in the encoding.
    """

    def __init__(
        self,
        spec: AvatarSpec,
        *,
        encoding_amplitude: float = 1.0,
        first_frequency: float = FIRST_FREQUENCY,
    ) -> None:
        super().__init__()
        self.encoding: SurfaceEncoding = make_encoding(spec, encoding_amplitude)
        self.xyz = Siren(3, spec.xyz_channels, linear_output=False, first_frequency=first_frequency)
        self.colour = Siren(
            spec.expression_channels + spec.xyz_channels[-1] + self.encoding.channels,
            spec.pixel_channels,
            linear_output=True,
            first_frequency=first_frequency,
        )

    def forward(self, expression: Tensor, xyz_m: Tensor, uv: Tensor) -> Tensor:
        """Colours of P pixels.

        Args:
            expression: Local expression codes, ``[P, 4]``.
            xyz_m: Head-frame positions in metres, ``[P, 3]``.
            uv: Surface coordinates in [0, 1], ``[P, 2]``.

        Returns:
            sRGB, 1.0 is 255; not clamped. ``[P, 3]``.
        """
        encoded = [expression, self.xyz(xyz_m / XYZ_UNIT_M), self.encoding(uv)]
        colours: Tensor = self.colour(torch.cat(encoded, 1))
        return colours
