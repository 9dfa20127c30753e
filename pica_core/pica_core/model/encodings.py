"""Surface encodings in torch: what the pixel decoder is told about a surface point.

Each class is one part; an encoding is several side by side. What they compute, and the numpy twins:
`pica_core.reference.surface_encoding`.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import final

import torch
from torch import Tensor, nn
from torch.nn import functional

from pica_core.avatar.spec import NUM_FREQUENCIES, AvatarSpec
from pica_core.model.decoders import sample_map


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

    def __init__(self, spec: AvatarSpec, amplitude: float) -> None:
        super().__init__()
        size, self.channels = spec.uv_encoding_size, spec.uv_encoding_channels
        values = torch.empty(1, self.channels, size, size).uniform_(-amplitude, amplitude)
        self.values = nn.Parameter(values)

    @torch.no_grad()
    def start_from(self, texture: Tensor, contrast: float) -> None:
        """Colours in the first three channels; the others stay as they are."""
        size = self.values.shape[2:]
        resized = functional.interpolate(texture[None], size, mode="bilinear", antialias=True)
        colours = min(3, self.channels)
        self.values[:, :colours] = contrast * (2 * resized[:, :colours] - 1)

    def forward(self, uv: Tensor) -> Tensor:
        """Look the map up between its four nearest texels."""
        return sample_map(self.values, uv)[0]

    def named_tensors(self) -> dict[str, Tensor]:
        """The map as ``uv_encoding``, channel-last."""
        return {"uv_encoding": self.values[0].permute(1, 2, 0)}


@final
class AxisTables(SurfaceEncoding):
    """m_u and m_v, piecewise linear, started as `JointMap` is."""

    def __init__(self, spec: AvatarSpec, amplitude: float) -> None:
        super().__init__()
        entries, single = spec.axis_encoding_size, spec.axis_encoding_channels
        self.channels = 2 * single
        self.along_u, self.along_v = (
            nn.Parameter(torch.empty(1, single, 1, entries).uniform_(-amplitude, amplitude))
            for _ in range(2)
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
