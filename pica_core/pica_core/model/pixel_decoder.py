"""The pixel decoder: two small sine networks over expression, position and surface encoding.

Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), sections 3 and 4 and appendix A.1; sine
networks and their initialisation: Sitzmann et al., "Implicit Neural Representations with Periodic
Activation Functions" (2020), with the frequency folded into the weights, so that a layer is
sin(W x + b) and nothing else, in torch, in the avatar file and in GLSL.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import final

import torch
from torch import Tensor, nn
from torch.nn import functional

from pica_core.avatar.spec import (
    AXIS_ENCODING_CHANNELS,
    EXPRESSION_CHANNELS,
    NUM_FREQUENCIES,
    PIXEL_CHANNELS,
    UV_ENCODING_CHANNELS,
    XYZ_CHANNELS,
    AvatarSpec,
)
from pica_core.model.networks import sample_map


class SurfaceEncoding(nn.Module, ABC):
    """Surface points to codes."""

    channels: int
    """Width of the codes."""

    @abstractmethod
    def forward(self, uv: Tensor) -> Tensor:
        """Encode points ``[P, 2]`` to ``[P, channels]``."""

    def start_from(self, texture: Tensor, contrast: float) -> None:
        """Begin with a person's mean texture, in parts that can hold one.

        Args:
            texture: 0 to 1, row 0 is v = 0, ``[3, T, T]``.
            contrast: What black and white become: minus and plus this.
        """

    def named_tensors(self) -> dict[str, Tensor]:
        """The weights under their names, and in the shapes, of the avatar file."""
        return {}


@final
class JointMap(SurfaceEncoding):
    """m_uv, piecewise bilinear, its entries uniform in [-amplitude, amplitude] at first."""

    channels = UV_ENCODING_CHANNELS

    def __init__(self, spec: AvatarSpec, amplitude: float) -> None:
        super().__init__()
        size = spec.uv_encoding_size
        values = torch.empty(1, self.channels, size, size).uniform_(-amplitude, amplitude)
        self.values = nn.Parameter(values)

    @torch.no_grad()
    def start_from(self, texture: Tensor, contrast: float) -> None:
        """Colours in the first three channels; the others stay as they are."""
        size = self.values.shape[2:]
        resized = functional.interpolate(texture[None], size, mode="bilinear", antialias=True)
        self.values[:, :3] = contrast * (2 * resized - 1)

    def forward(self, uv: Tensor) -> Tensor:
        """Look the map up between its four nearest texels."""
        return sample_map(self.values, uv)[0]

    def named_tensors(self) -> dict[str, Tensor]:
        """The map as ``uv_encoding``, channel-last."""
        return {"uv_encoding": self.values[0].permute(1, 2, 0)}


@final
class AxisTables(SurfaceEncoding):
    """m_u and m_v, piecewise linear, started as `JointMap` is."""

    channels = 2 * AXIS_ENCODING_CHANNELS

    def __init__(self, spec: AvatarSpec, amplitude: float) -> None:
        super().__init__()
        shape = 1, AXIS_ENCODING_CHANNELS, 1, spec.axis_encoding_size
        self.along_u, self.along_v = (
            nn.Parameter(torch.empty(shape).uniform_(-amplitude, amplitude)) for _ in range(2)
        )

    def forward(self, uv: Tensor) -> Tensor:
        """Look each table up between its two nearest entries."""
        middle = torch.full_like(uv[:, :1], 0.5)
        along_u = sample_map(self.along_u, torch.cat([uv[:, :1], middle], 1))
        along_v = sample_map(self.along_v, torch.cat([uv[:, 1:], middle], 1))
        return torch.cat([along_u, along_v], 2)[0]

    def named_tensors(self) -> dict[str, Tensor]:
        """The tables as ``u_encoding`` and ``v_encoding``, channel-last."""
        return {"u_encoding": self.along_u[0, :, 0].T, "v_encoding": self.along_v[0, :, 0].T}


@final
class RawUv(SurfaceEncoding):
    """The coordinates in [-1, 1]; no weights."""

    channels = 2

    def forward(self, uv: Tensor) -> Tensor:
        """2 uv - 1."""
        return 2 * uv - 1


@final
class Sinusoids(SurfaceEncoding):
    """Ten octaves of sines and cosines; no weights."""

    channels = 4 * NUM_FREQUENCIES

    def forward(self, uv: Tensor) -> Tensor:
        """Whole turns are taken off first, which is exact in any precision."""
        octaves: list[Tensor] = []
        for octave in range(NUM_FREQUENCIES):
            turns = uv * float(1 << octave)
            angle = (turns - turns.detach().floor()) * (2 * math.pi)
            octaves += [angle.sin(), angle.cos()]
        return torch.cat(octaves, 1)


PARTS: dict[str, Callable[[AvatarSpec, float], SurfaceEncoding]] = {
    "joint": JointMap,
    "axes": AxisTables,
    "uv": lambda spec, amplitude: RawUv(),
    "sinusoids": lambda spec, amplitude: Sinusoids(),
}


@final
class SideBySide(SurfaceEncoding):
    """The parts that a spec names, one after another; none at all makes codes of width 0.

    Args:
        amplitude: Half-width of the tables' uniform start, 1 in the paper.
    """

    def __init__(self, spec: AvatarSpec, amplitude: float) -> None:
        super().__init__()
        self._encodings = [PARTS[part](spec, amplitude) for part in spec.encoding_channels]
        self.parts = nn.ModuleList(self._encodings)
        self.channels = sum(part.channels for part in self._encodings)

    def start_from(self, texture: Tensor, contrast: float) -> None:
        """Let each part begin with the texture."""
        for part in self._encodings:
            part.start_from(texture, contrast)

    def forward(self, uv: Tensor) -> Tensor:
        """All parts' codes."""
        return torch.cat([uv[:, :0], *(part(uv) for part in self.parts)], 1)

    def named_tensors(self) -> dict[str, Tensor]:
        """All parts' weights."""
        return {name: t for part in self._encodings for name, t in part.named_tensors().items()}


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
    ) -> None:
        super().__init__()
        self.encoding = SideBySide(spec, encoding_amplitude)
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
