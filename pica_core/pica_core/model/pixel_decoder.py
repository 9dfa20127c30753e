"""The pixel decoder: two small sine networks over expression, position and surface encoding.

Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), sections 3 and 4 and appendix A.1; sine
networks and their initialisation: Sitzmann et al., "Implicit Neural Representations with Periodic
Activation Functions" (2020), with the frequency folded into the weights, so that a layer is
sin(W x + b) and nothing else, in torch, in the avatar file and in GLSL.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from pica_core.avatar.spec import (
    EXPRESSION_CHANNELS,
    NUM_FREQUENCIES,
    PIXEL_CHANNELS,
    XYZ_CHANNELS,
    AvatarSpec,
)
from pica_core.model.networks import sample_map


class SurfaceEncoding(nn.Module):
    """Surface points to codes: the parts that a spec names, one after another; none at all makes
    codes of width 0.

    Maps and tables are read linearly, and their entries uniform in [-amplitude, amplitude] at
    first.

    Args:
        amplitude: 1 in the paper.
    """

    def __init__(self, spec: AvatarSpec, amplitude: float) -> None:
        super().__init__()
        self._parts = [_PARTS[part] for part in spec.encoding_channels]
        self._shapes = spec.encoding_shapes
        for name, (*size, channels) in self._shapes.items():
            values = torch.empty(1, channels, *[1, *size][-2:])
            self.register_parameter(name, nn.Parameter(values.uniform_(-amplitude, amplitude)))

    @torch.no_grad()
    def start_from(self, texture: Tensor, contrast: float) -> None:
        """Begin with a person's mean texture in the first three channels of m_uv, if there is one.

        Args:
            texture: 0 to 1, row 0 is v = 0, ``[3, T, T]``.
            contrast: What black and white become: minus and plus this.
        """
        if (joint := self.tables.get("uv_encoding")) is not None:
            size = joint.shape[2:]
            resized = functional.interpolate(texture[None], size, mode="bilinear", antialias=True)
            joint[:, :3] = contrast * (2 * resized - 1)

    def forward(self, uv: Tensor) -> Tensor:
        """Encode points ``[P, 2]`` to ``[P, C]``."""
        return _beside([uv[:, :0], *(part(self.tables, uv) for part in self._parts)])

    @property
    def tables(self) -> dict[str, Tensor]:
        """Maps and tables under their names in the avatar file, ``[1, C, H, W]``; H is 1 in
        tables."""
        return dict(self.named_parameters())

    def named_tensors(self) -> dict[str, Tensor]:
        """The same in the shapes of the avatar file, channel-last."""
        return {
            name: values[0].permute(1, 2, 0).reshape(self._shapes[name])
            for name, values in self.tables.items()
        }


def _beside(codes: Sequence[Tensor]) -> Tensor:
    """Codes ``[P, ...]`` one after another; in memory each channel is a row, which narrow layers
    are multiplied with in half of the time."""
    return torch.cat([each.T for each in codes]).T


def _axes(tables: dict[str, Tensor], uv: Tensor) -> Tensor:
    middle = torch.full_like(uv[:, :1], 0.5)
    along_u = sample_map(tables["u_encoding"], torch.cat([uv[:, :1], middle], 1))
    along_v = sample_map(tables["v_encoding"], torch.cat([uv[:, 1:], middle], 1))
    return torch.cat([along_u, along_v], 2)[0]


def _sinusoids(_: dict[str, Tensor], uv: Tensor) -> Tensor:
    octaves: list[Tensor] = []
    for octave in range(NUM_FREQUENCIES):
        turns = uv * float(1 << octave)
        # Whole turns are taken off first, which is exact in any precision.
        angle = (turns - turns.detach().floor()) * (2 * math.pi)
        octaves += [angle.sin(), angle.cos()]
    return torch.cat(octaves, 1)


_PARTS: dict[str, Callable[[dict[str, Tensor], Tensor], Tensor]] = {
    "joint": lambda tables, uv: sample_map(tables["uv_encoding"], uv)[0],
    "axes": _axes,
    "uv": lambda tables, uv: 2 * uv - 1,
    "sinusoids": _sinusoids,
}
"""Codes of points ``[P, 2]`` by each part of `spec.ENCODINGS`."""
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


def _linear(layer: nn.Linear, values: Tensor) -> Tensor:
    """What a layer makes of values ``[P, C]``, in memory as `_beside` has them."""
    return torch.addmm(layer.bias[:, None], layer.weight, values.T).T


class Siren(nn.Module):
    """Layers sin(W x + b); the last one linear if `linear_output`."""

    def __init__(
        self, in_channels: int, out_channels: Sequence[int], *, linear_output: bool
    ) -> None:
        super().__init__()
        self.linear_output = linear_output
        widths = pairwise([in_channels, *out_channels])
        self._layers = [nn.Linear(few, many) for few, many in widths]
        self.layers = nn.ModuleList(self._layers)
        self.draw()

    def draw(self) -> None:
        """Take new random weights."""
        for index, layer in enumerate(self._layers):
            bound = math.sqrt(6 / layer.in_features)
            if index == 0:
                bound = FIRST_FREQUENCY / layer.in_features
            elif self.linear_output and index + 1 == len(self._layers):
                bound /= FIRST_FREQUENCY
            nn.init.uniform_(layer.weight, -bound, bound)
            nn.init.uniform_(layer.bias, -math.pi, math.pi)
        if self.linear_output:
            nn.init.constant_(layer.bias, 0.5)

    def forward(self, values: Tensor) -> Tensor:
        """``[P, in]`` to ``[P, out]``."""
        output = _linear(self.last, self.hidden(values))
        return output if self.linear_output else torch.sin(output)

    @property
    def last(self) -> nn.Linear:
        """The last layer."""
        return self._layers[-1]

    def hidden(self, values: Tensor) -> Tensor:
        """What the last layer is given, ``[P, in]`` to ``[P, C]``."""
        for layer in self._layers[:-1]:
            values = torch.sin(_linear(layer, values))
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

    def __init__(self, spec: AvatarSpec, *, encoding_amplitude: float = 1.0) -> None:
        super().__init__()
        self.encoding = SurfaceEncoding(spec, encoding_amplitude)
        self.xyz = Siren(3, XYZ_CHANNELS, linear_output=False)
        self.colour = Siren(spec.pixel_input_channels, PIXEL_CHANNELS, linear_output=True)

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
        silent = torch.zeros(len(uv), EXPRESSION_CHANNELS)
        encoded = self.encoding(uv)
        best, kept = math.inf, self.state_dict()
        for _ in range(STARTS):
            self.xyz.draw()
            self.colour.draw()
            given = _beside([silent, self.xyz(xyz_m / XYZ_UNIT_M), encoded])
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
        return self.colour(_beside(encoded))
