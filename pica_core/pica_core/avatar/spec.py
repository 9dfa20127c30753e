"""The sizes of a Pixel Codec Avatar, in one place.

Every default is the paper's (Ma et al., "Pixel Codec Avatars", CVPR 2021, section 3 and appendix
A.1) unless its line says otherwise. A spec is data: it is written into avatar files and
checkpoints, and a reader rebuilds graphs and shaders from these numbers alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

from pica_core.errors import check_ranges
from pica_core.latent import LATENT_CHANNELS, LATENT_SIZE

VIEW_CHANNELS = 3
POSITION_CHANNELS = 3
RGB_CHANNELS = 3
LEAKY_SLOPE = 0.2
"""Negative slope of every LeakyReLU (paper A.1)."""
BLOCKS = ("H2", "G")
"""Building blocks of the decoders: the paper's, which it draws in a figure only (3b), and ours."""

ENCODINGS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "full": ("joint", "axes"),
        "none": (),
        "uv": ("uv",),
        "sinusoids": ("sinusoids",),
        "joint": ("joint",),
        "axes": ("axes",),
    }
)
"""What the pixel decoder is told about the surface point (u, v), side by side, by name.

joint: a learned map m_uv. axes: learned tables m_u and m_v. Both are the paper's encoding (section
4). uv: the coordinates themselves. sinusoids: 40 sines and cosines of them.
"""
NUM_FREQUENCIES = 10
"""Octaves of the sinusoids: two coordinates, sine and cosine make 40 values (paper 6)."""
SHEET_COLUMNS = 256
"""Vertices in a row of the sheet that bases make."""
GEOMETRIES = ("decoder", "bases")
"""Where vertices come from: a map that a decoder makes, or bases (`pica_core.avatar.linear`)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarSpec:
    """Everything that fixes the shapes of an avatar's tensors."""

    block: str = "G"
    """Building block of the two per-object decoders (our choice; see `decoder_layers`)."""
    map_size: int = 256
    """Rows and columns of position map and expression map, texels. A power of two times
    `LATENT_SIZE`.
    """
    hidden_channels: tuple[int, ...] = (32, 16, 16, 8)
    """Output channels of all decoder blocks but the last."""
    expression_channels: int = 4
    """Channels of the expression map E."""
    uv_encoding_size: int = 1024
    """Rows and columns of the joint encoding map m_uv, texels."""
    uv_encoding_channels: int = 4
    axis_encoding_size: int = 10_000
    """Entries of each of the per-axis encodings m_u and m_v."""
    axis_encoding_channels: int = 2
    xyz_channels: tuple[int, ...] = (4, 4)
    """Output channels of the SIREN that encodes head-frame xyz."""
    pixel_channels: tuple[int, ...] = (8, 8, 8, RGB_CHANNELS)
    """Output channels of the pixel decoder's layers."""
    encoding: str = "full"
    """What the pixel decoder is told about the surface point; one of `ENCODINGS`."""
    geometry: str = "decoder"
    """Where vertices come from; one of `GEOMETRIES` (the paper has a decoder)."""

    def __post_init__(self) -> None:
        for name, known in (("block", BLOCKS), ("encoding", ENCODINGS), ("geometry", GEOMETRIES)):
            if (value := getattr(self, name)) not in known:
                raise ValueError(f"{name} is {value!r:.40}; known are {', '.join(known)}")
        doublings = len(self.hidden_channels) + 1
        if self.map_size != LATENT_SIZE << doublings:
            raise ValueError(
                f"map_size is {self.map_size}; "
                f"{doublings} decoder blocks make {LATENT_SIZE << doublings}"
            )
        if self.geometry == "bases" and self.map_size != SHEET_COLUMNS:
            raise ValueError(f"map_size is {self.map_size}; bases need {SHEET_COLUMNS}")
        check_ranges(
            self,
            expression_channels=(1, 16),
            uv_encoding_size=(1, 4096),
            uv_encoding_channels=(1, 4),
            axis_encoding_size=(1, 16_384),
            axis_encoding_channels=(1, 2),
        )
        for name in ("hidden_channels", "xyz_channels", "pixel_channels"):
            widths = getattr(self, name)
            if not 1 <= len(widths) <= 8 or not all(1 <= width <= 64 for width in widths):
                raise ValueError(f"{name} is {widths}; allowed are 1 to 8 layers of width 1 to 64")
        if self.pixel_channels[-1] != RGB_CHANNELS:
            raise ValueError(f"pixel_channels ends in {self.pixel_channels[-1]}; colours have 3")

    @property
    def decoder_channels(self) -> dict[str, tuple[int, tuple[int, ...]]]:
        """Input channels and each block's output channels of the decoders, by name: "geometry"
        where no bases make the vertices, and "expression"."""
        channels = {
            "geometry": (LATENT_CHANNELS, (*self.hidden_channels, POSITION_CHANNELS)),
            "expression": (
                LATENT_CHANNELS + VIEW_CHANNELS,
                (*self.hidden_channels, self.expression_channels),
            ),
        }
        if self.geometry == "bases":
            del channels["geometry"]
        return channels

    @property
    def encoding_channels(self) -> dict[str, int]:
        """Channels of each part of the surface encoding, in the order in which they are fed."""
        channels = {
            "joint": self.uv_encoding_channels,
            "axes": 2 * self.axis_encoding_channels,
            "uv": 2,
            "sinusoids": 4 * NUM_FREQUENCIES,
        }
        return {part: channels[part] for part in ENCODINGS[self.encoding]}

    @property
    def encoding_shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every tensor of the surface encoding; maps have row 0 at v = 0."""
        size = self.uv_encoding_size
        table = (self.axis_encoding_size, self.axis_encoding_channels)
        shapes: dict[str, dict[str, tuple[int, ...]]] = {
            "joint": {"uv_encoding": (size, size, self.uv_encoding_channels)},
            "axes": {"u_encoding": table, "v_encoding": table},
        }
        parts = [shapes[part] for part in ENCODINGS[self.encoding] if part in shapes]
        return {name: shape for part in parts for name, shape in part.items()}

    @property
    def pixel_input_channels(self) -> int:
        """Width of p = [z, x, u]: expression code, encoded xyz, encoded uv. 16 in the paper."""
        uv_channels = sum(self.encoding_channels.values())
        return self.expression_channels + self.xyz_channels[-1] + uv_channels

    def to_json(self) -> dict[str, Any]:
        """The spec as plain JSON values; `from_json` reads it back."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Any) -> AvatarSpec:
        """Read a spec, trusting nothing.

        Raises:
            ValueError: Not a map, an unknown or missing field, a wrong type, or a size out of
                range.
        """
        if not isinstance(values, dict):
            raise ValueError(f"spec is {type(values).__name__}; a map is needed")
        read = dict(values)
        usual = asdict(cls())
        if wrong := sorted(usual.keys() ^ set(map(str, read))):
            told = ", ".join(f"{name!r:.40}" for name in wrong[:4])
            raise ValueError(f"spec fields missing or unknown: {told}")
        for name, value in read.items():
            kind = type(usual[name])
            if isinstance(value, list) and len(value) <= 8:
                read[name] = tuple(value)
            fits = type(read[name]) is kind
            if not fits or (kind is tuple and any(type(item) is not int for item in read[name])):
                needed = {str: "a string", int: "an integer", tuple: "a list of up to 8 integers"}
                raise ValueError(f"spec.{name} is {value!r:.80}; {needed[kind]} is needed")
        return cls(**read)
