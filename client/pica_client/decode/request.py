"""What a decoder is asked for and what it gives. Pure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from pica_core.types import FloatArray

DecodeChoice = Literal["auto", "cpu", "gpu"]
"""Where to decode: in shaders, by ONNX Runtime, or in shaders where a GPU draws."""
Parts = Literal["both", "expression"]
"""Maps to make: both, or the expression map alone."""


@dataclass(frozen=True, slots=True, eq=False)
class DecodedMaps:
    """What a decoder makes of one latent."""

    position_map: FloatArray | None
    """Head-frame metres, float32 ``[S, S, 3]`` or a sheet ``[R, S, 3]``, C-contiguous; None if it
    was not asked for, or is on the GPU already."""
    expression_map: FloatArray | None
    """float32 ``[S, S, 4]``, C-contiguous; None if it is on the GPU already."""
    level: int = 0
    """S, texels per side of what was decoded."""


@dataclass(frozen=True, slots=True, eq=False)
class DecodeRequest:
    """One latent to decode."""

    latent: FloatArray
    """float32 ``[8, 8, 4]``."""
    view_direction: FloatArray
    """Camera centre seen from the head, unit length, head frame. float32 ``[3]``."""
    captured_us: int
    """Sender's clock at the newest sample in the latent; handed through."""
    level: int | None = None
    """Texels per side of the maps, one of the avatar's levels; None is the full one."""
    parts: Parts = "both"
    """Which maps to make. Ask for the expression map alone with the latent that the position map
    was made of."""

    def widened_by(self, former: DecodeRequest) -> DecodeRequest:
        """This request instead of one that still waits, with the parts of both."""
        return self if self.parts == former.parts else replace(self, parts="both")


@dataclass(frozen=True, slots=True, eq=False)
class DecodeResult:
    """What became of a request, or of an avatar. Times are seconds of the pool's clock."""

    slot: str
    maps: DecodedMaps | None
    """None after an error."""
    error: str | None
    """Why this avatar cannot be decoded; it stays broken until it is added again."""
    captured_us: int = 0
    submitted_s: float = 0.0
    started_s: float = 0.0
    finished_s: float = 0.0
    parts: Parts = "both"
    """What was decoded."""

    @property
    def level(self) -> int:
        """Level that was decoded; 0 after an error."""
        return 0 if self.maps is None else self.maps.level

    @property
    def decode_s(self) -> float:
        """Seconds of computing; building a decoder is not counted."""
        return self.finished_s - self.started_s

    @property
    def waited_s(self) -> float:
        """Seconds from submission until a worker took it."""
        return self.started_s - self.submitted_s
