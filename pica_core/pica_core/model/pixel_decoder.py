"""The pixel decoder: two small sine networks over expression, position and surface encoding.

Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), sections 3 and 4 and appendix A.1; sine
networks and their initialisation: Sitzmann et al., "Implicit Neural Representations with Periodic
Activation Functions" (2020), with the frequency folded into the weights, so that a layer is
sin(W x + b) and nothing else, in torch, in the avatar file and in GLSL.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from pica_core.avatar.spec import AvatarSpec
from pica_core.model.decoders import sample_map
from pica_core.model.encodings import SideBySide

XYZ_UNIT_M = 0.1
"""Head-frame coordinates enter the network in this unit, which brings a face to about [-1, 1]."""
STARTS = 64
"""Random starts of the two networks, of which the one is taken that can show the mean texture best
(measured, docs/training.md: with one start the error hangs on luck by a factor of two)."""
START_POINTS = 4096
"""Points of the surface that starts are compared at."""
START_RIDGE = 1e-3
"""Keeps the last layer's weights small where its inputs hardly differ."""
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
        self.linear_output, self._first_frequency = linear_output, first_frequency
        widths = pairwise([in_channels, *out_channels])
        self._layers = [nn.Linear(few, many) for few, many in widths]
        self.layers = nn.ModuleList(self._layers)
        self.draw()

    def draw(self) -> None:
        """Take new random weights."""
        for index, layer in enumerate(self._layers):
            bound = math.sqrt(6 / layer.in_features)
            if index == 0:
                bound = self._first_frequency / layer.in_features
            elif self.linear_output and index + 1 == len(self._layers):
                bound /= FIRST_FREQUENCY
            nn.init.uniform_(layer.weight, -bound, bound)
            nn.init.uniform_(layer.bias, -math.pi, math.pi)
        if self.linear_output:
            nn.init.constant_(layer.bias, 0.5)

    def forward(self, values: Tensor) -> Tensor:
        """``[P, in]`` to ``[P, out]``."""
        output: Tensor = self.last(self.hidden(values))
        return output if self.linear_output else torch.sin(output)

    @property
    def last(self) -> nn.Linear:
        """The last layer."""
        return self._layers[-1]

    def hidden(self, values: Tensor) -> Tensor:
        """What the last layer is given, ``[P, in]`` to ``[P, C]``."""
        for layer in self._layers[:-1]:
            values = torch.sin(layer(values))
        return values

    def named_tensors(self, prefix: str) -> dict[str, Tensor]:
        """Weights and biases as ``{prefix}.{i}.weight`` and ``{prefix}.{i}.bias``."""
        return {
            f"{prefix}.{index}.{kind}": getattr(layer, kind)
            for index, layer in enumerate(self._layers)
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
        self.expression_channels = spec.expression_channels
        self.encoding = SideBySide(spec, encoding_amplitude)
        self.xyz = Siren(3, spec.xyz_channels, linear_output=False, first_frequency=first_frequency)
        self.colour = Siren(
            spec.expression_channels + spec.xyz_channels[-1] + self.encoding.channels,
            spec.pixel_channels,
            linear_output=True,
            first_frequency=first_frequency,
        )

    @torch.no_grad()
    def start_from(self, texture: Tensor, contrast: float, xyz_m: Tensor, uv: Tensor) -> None:
        """Begin with a person's mean texture: in the encoding, and by the choice of the networks.

        Of `STARTS` random starts the one stays whose last layer, by least squares, comes nearest to
        the texture at rest; it keeps that layer.

        Args:
            texture: See `SurfaceEncoding.start_from`, also for `contrast`.
            xyz_m: Points of the surface at rest, ``[P, 3]``.
            uv: Where they lie in the texture, ``[P, 2]``.
        """
        self.encoding.start_from(texture, contrast)
        some = slice(None, None, -(-len(uv) // START_POINTS))
        uv, xyz_m = uv[some], xyz_m[some]
        wanted = sample_map(texture[None], uv)[0].double()
        silent = torch.zeros(len(uv), self.expression_channels)
        encoded = self.encoding(uv)
        best, kept = math.inf, self.state_dict()
        for _ in range(STARTS):
            self.xyz.draw()
            self.colour.draw()
            given = torch.cat([silent, self.xyz(xyz_m / XYZ_UNIT_M), encoded], 1)
            inputs = self.colour.hidden(given).double()
            mean, mean_colour = inputs.mean(0), wanted.mean(0)
            offsets, colours = inputs - mean, wanted - mean_colour
            products = offsets.T @ offsets + START_RIDGE * len(uv) * torch.eye(inputs.shape[1])
            weight = torch.linalg.solve(products, offsets.T @ colours).T
            left = float((offsets @ weight.T - colours).square().mean())
            if left < best:
                best = left
                self.colour.last.weight.copy_(weight)
                self.colour.last.bias.copy_(mean_colour - weight @ mean)
                kept = {name: values.clone() for name, values in self.state_dict().items()}
        self.load_state_dict(kept)

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
