"""The sizes of a Pixel Codec Avatar, and its decoders as a list of plain layers, in one place.

Every width and default is the paper's (Ma et al., "Pixel Codec Avatars", CVPR 2021, section 3 and
appendix A.1) unless its line says otherwise. A spec is data: it is written into avatar files, and a
reader rebuilds graphs and shaders from it alone.

The paper's block (Fig. 3b) doubles the resolution and gives its first convolution a bias per
channel *and* location ("untied bias"); the figure itself is not in the text. Two, by name in the
spec:

    H2   conv 3x3, untied bias at input size, leaky; deconv 4x4 stride 2, untied bias at output
         size, leaky; conv 3x3 (the paper's, as we read it)
    G    conv 3x3, untied bias at input size, leaky; conv 1x1 to 4c; pixel shuffle; and in the
         decoders of geometry a factor per channel and location ("untied gain") at its output: what
         moves how far, such as lips beside each other that an opening jaw parts, need not be made
         of biases (3-4 times fewer multiply-adds)

A LeakyReLU follows every block but the last, whose output is the map itself.

The models of the paper's tables are rows, each `FULL` with one part replaced:

    full       the Pixel Codec Avatar (section 3)
    linear     full with vertices by bases in closed form (ours)
    no_uv      the pixel decoder is not told where on the surface it is
    coarse     the tracked mesh is drawn, not the dense one
    uv_nope    (u, v) as they are, without an encoding
    nerf_pe    sines and cosines of (u, v), 40 values
    pe_2d      the joint map m_uv alone
    pe_1d      the per-axis tables m_u and m_v alone
    baseline   a mesh and a whole texture (Lombardi et al. 2018)

What the paper says of each, what it leaves open and what we chose: `docs/training.md`.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from math import prod
from types import MappingProxyType
from typing import Any, Literal

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.errors import check_ranges
from pica_core.types import LATENT_CHANNELS, LATENT_SIZE, NUM_LATENT

VIEW_CHANNELS = 3
POSITION_CHANNELS = 3
RGB_CHANNELS = 3
LEAKY_SLOPE = 0.2
"""Negative slope of every LeakyReLU (paper A.1)."""
BLOCKS = ("H2", "G")
"""Building blocks of the decoders: the paper's, which it draws in a figure only (3b), and ours."""
HIDDEN_CHANNELS = (32, 16, 16, 8)
"""Output channels of all decoder blocks but the last."""
MAP_SIZE = LATENT_SIZE << (len(HIDDEN_CHANNELS) + 1)
"""Rows and columns of position map and expression map, texels: 256. Also the vertices in a row of
the sheet that bases make."""
EXPRESSION_CHANNELS = 4
"""Channels of the expression map E."""
XYZ_CHANNELS = (4, 4)
"""Output channels of the SIREN that encodes head-frame xyz."""
PIXEL_CHANNELS = (8, 8, 8, RGB_CHANNELS)
"""Output channels of the pixel decoder's layers."""
ENCODER_CHANNELS = (160, 160, NUM_LATENT)
"""Output channels of the layers of the expression encoder, which turns ARKit values into a latent
(ours)."""

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
UV_ENCODING_CHANNELS = 4
"""Channels of the joint encoding map m_uv."""
AXIS_ENCODING_CHANNELS = 2
"""Channels of each of the per-axis tables m_u and m_v."""
NUM_FREQUENCIES = 10
"""Octaves of the sinusoids: two coordinates, sine and cosine make 40 values (paper 6)."""
_PART_CHANNELS = {
    "joint": UV_ENCODING_CHANNELS,
    "axes": 2 * AXIS_ENCODING_CHANNELS,
    "uv": 2,
    "sinusoids": 4 * NUM_FREQUENCIES,
}
GEOMETRIES = ("decoder", "bases")
"""Where vertices come from: a map that a decoder makes, or bases (`pica_core.avatar.linear`)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarSpec:
    """What differs between the tensors of two avatars; their widths are the same for all."""

    block: str = "G"
    """Building block of the two per-object decoders (our choice; see `decoder_layers`)."""
    uv_encoding_size: int = 1024
    """Rows and columns of the joint encoding map m_uv, texels."""
    axis_encoding_size: int = 10_000
    """Entries of each of the per-axis encodings m_u and m_v."""
    encoding: str = "full"
    """What the pixel decoder is told about the surface point; one of `ENCODINGS`."""
    geometry: str = "decoder"
    """Where vertices come from; one of `GEOMETRIES` (the paper has a decoder)."""

    def __post_init__(self) -> None:
        for name, known in (("block", BLOCKS), ("encoding", ENCODINGS), ("geometry", GEOMETRIES)):
            if (value := getattr(self, name)) not in known:
                raise ValueError(f"{name} is {value!r:.40}; known are {', '.join(known)}")
        check_ranges(self, uv_encoding_size=(1, 4096), axis_encoding_size=(1, 16_384))

    @property
    def decoders(self) -> tuple[str, ...]:
        """The per-object decoders: "geometry" where no bases make the vertices, and
        "expression"."""
        return ("expression",) if self.geometry == "bases" else ("geometry", "expression")

    @property
    def encoding_channels(self) -> dict[str, int]:
        """Channels of each part of the surface encoding, in the order in which they are fed."""
        return {part: _PART_CHANNELS[part] for part in ENCODINGS[self.encoding]}

    @property
    def encoding_shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every tensor of the surface encoding; maps have row 0 at v = 0."""
        size, parts = self.uv_encoding_size, ENCODINGS[self.encoding]
        table = (self.axis_encoding_size, AXIS_ENCODING_CHANNELS)
        shapes: dict[str, tuple[int, ...]] = {}
        if "joint" in parts:
            shapes["uv_encoding"] = (size, size, UV_ENCODING_CHANNELS)
        if "axes" in parts:
            shapes |= {"u_encoding": table, "v_encoding": table}
        return shapes

    @property
    def pixel_input_channels(self) -> int:
        """Width of p = [z, x, u]: expression code, encoded xyz, encoded uv. 16 in the paper."""
        return EXPRESSION_CHANNELS + XYZ_CHANNELS[-1] + sum(self.encoding_channels.values())

    @classmethod
    def from_json(cls, values: Any) -> "AvatarSpec":
        """Read what `dataclasses.asdict` makes of a spec, trusting nothing.

        Raises:
            ValueError: Not a map, an unknown or missing field, a wrong type, or a size out of
                range.
        """
        if not isinstance(values, dict):
            raise ValueError(f"spec is {type(values).__name__}; a map is needed")
        usual = asdict(cls())
        if wrong := sorted(usual.keys() ^ values):
            raise ValueError(f"spec field {wrong[0]!r:.40} is missing or unknown")
        for name, value in values.items():
            if type(value) is not (kind := type(usual[name])):
                raise ValueError(f"spec.{name} is {value!r:.80}; {kind.__name__} is needed")
        return cls(**values)


LayerKind = Literal[
    "conv3", "conv1", "deconv4", "untied_bias", "untied_gain", "leaky_relu", "pixel_shuffle"
]


@dataclass(frozen=True, slots=True)
class Layer:
    """One operation of a decoder; weighted ones own ``{name}.weight`` (and ``{name}.bias``).

    Tensor shapes, float32, torch's layout: conv weight ``[out, in, k, k]`` and bias ``[out]``;
    deconv weight ``[in, out, 4, 4]`` and bias ``[out]`` (padding 1); untied_bias and untied_gain
    ``{name}.weight`` ``[out, size, size]``. A convolution directly before an untied bias has no
    bias of its own: `has_bias` is False.
    """

    kind: LayerKind
    name: str
    in_channels: int
    out_channels: int
    size: int
    """Rows and columns of this layer's *output*."""
    has_bias: bool = False

    def tensor_shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every tensor that this layer owns; empty for layers without weights."""
        weight = f"{self.name}.weight"
        shapes: dict[str, tuple[int, ...]]
        match self.kind:
            case "conv3" | "conv1":
                kernel = 3 if self.kind == "conv3" else 1
                shapes = {weight: (self.out_channels, self.in_channels, kernel, kernel)}
            case "deconv4":
                shapes = {weight: (self.in_channels, self.out_channels, 4, 4)}
            case "untied_bias" | "untied_gain":
                return {weight: (self.out_channels, self.size, self.size)}
            case _:
                return {}
        if self.has_bias:
            shapes[f"{self.name}.bias"] = (self.out_channels,)
        return shapes

    @property
    def multiply_adds(self) -> int:
        """Multiply-adds of one evaluation at batch 1; biases and activations are not counted."""
        if self.kind == "untied_gain":
            return self.out_channels * self.size * self.size
        taps = {"conv3": 9, "conv1": 1, "deconv4": 4}.get(self.kind, 0)
        return taps * self.in_channels * self.out_channels * self.size * self.size


def decoder_layers(spec: AvatarSpec, decoder: str) -> list[Layer]:
    """The layers of the decoder named ``"geometry"`` or ``"expression"``, in order.

    Input is ``[N, C, 8, 8]`` (Z, with the tiled view direction after it for "expression"), output
    ``[N, C, 256, 256]``.
    """
    in_channels, last = LATENT_CHANNELS, POSITION_CHANNELS
    if decoder == "expression":
        in_channels, last = LATENT_CHANNELS + VIEW_CHANNELS, EXPRESSION_CHANNELS
    outputs = (*HIDDEN_CHANNELS, last)
    layers: list[Layer] = []
    size = LATENT_SIZE
    for index, out_channels in enumerate(outputs):
        layers += _block(spec.block, f"{decoder}.{index}", in_channels, out_channels, size)
        size *= 2
        if spec.block == "G" and decoder != "expression":
            name = f"{decoder}.{index}.gain"
            layers.append(Layer("untied_gain", name, out_channels, out_channels, size))
        in_channels = out_channels
        if index + 1 < len(outputs):
            name = f"{decoder}.{index}.out"
            layers.append(Layer("leaky_relu", name, out_channels, out_channels, size))
    return layers


def spec_tensor_shapes(spec: AvatarSpec) -> dict[str, tuple[int, ...]]:
    """Name and shape of every tensor that the spec fixes: all but mesh, bases and levels."""
    shapes: dict[str, tuple[int, ...]] = {}
    if spec.geometry == "decoder":
        shapes["geometry.mean"] = (MAP_SIZE, MAP_SIZE, POSITION_CHANNELS)
    for decoder in spec.decoders:
        for layer in decoder_layers(spec, decoder):
            shapes.update(layer.tensor_shapes())
    shapes |= spec.encoding_shapes
    for prefix, width, outputs in (
        ("xyz", POSITION_CHANNELS, XYZ_CHANNELS),
        ("pixel", spec.pixel_input_channels, PIXEL_CHANNELS),
        ("encoder", NUM_ARKIT, ENCODER_CHANNELS),
    ):
        for index, out in enumerate(outputs):
            shapes[f"{prefix}.{index}.weight"] = (out, width)
            shapes[f"{prefix}.{index}.bias"] = (out,)
            width = out
    return shapes


def trunk_layers(spec: AvatarSpec, level: int) -> list[Layer]:
    """The layers of the expression decoder that lead to maps of `level` rows, up to the LeakyReLU
    behind the block that makes them."""
    layers = decoder_layers(spec, "expression")
    ends = (at for at, each in enumerate(layers, 1) if each.name.endswith(".out"))
    return layers[: next(end for end in ends if layers[end - 1].size == level)]


def _block(block: str, prefix: str, c_in: int, c_out: int, size: int) -> list[Layer]:
    first = [
        Layer("conv3", f"{prefix}.first", c_in, c_out, size),
        Layer("untied_bias", f"{prefix}.first_bias", c_out, c_out, size),
        Layer("leaky_relu", f"{prefix}.first_act", c_out, c_out, size),
    ]
    if block == "H2":
        return [
            *first,
            Layer("deconv4", f"{prefix}.up", c_out, c_out, size * 2),
            Layer("untied_bias", f"{prefix}.up_bias", c_out, c_out, size * 2),
            Layer("leaky_relu", f"{prefix}.up_act", c_out, c_out, size * 2),
            Layer("conv3", f"{prefix}.conv", c_out, c_out, size * 2, has_bias=True),
        ]
    return [
        *first,
        Layer("conv1", f"{prefix}.expand", c_out, 4 * c_out, size, has_bias=True),
        Layer("pixel_shuffle", f"{prefix}.shuffle", 4 * c_out, c_out, size * 2),
    ]


TopologyName = Literal["dense", "tracked"]
Network = Literal["pixel_codec", "deep_appearance"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Variant:
    """What may differ between two rows."""

    network: Network = "pixel_codec"
    """Colours by a pixel decoder, or a whole texture."""
    encoding: str = "full"
    """What a pixel decoder is told about the surface point (`spec.ENCODINGS`)."""
    topology: TopologyName = "dense"
    """Which mesh of the capture is drawn."""
    geometry: str = "decoder"
    """Where vertices come from (`spec.GEOMETRIES`)."""


FULL = Variant()
VARIANTS: Mapping[str, Variant] = MappingProxyType(
    {
        "full": FULL,
        "linear": replace(FULL, geometry="bases"),
        "no_uv": replace(FULL, encoding="none"),
        "coarse": replace(FULL, topology="tracked"),
        "uv_nope": replace(FULL, encoding="uv"),
        "nerf_pe": replace(FULL, encoding="sinusoids"),
        "pe_2d": replace(FULL, encoding="joint"),
        "pe_1d": replace(FULL, encoding="axes"),
        "baseline": replace(FULL, network="deep_appearance", topology="tracked"),
    }
)


@dataclass(frozen=True, kw_only=True, slots=True)
class ModelCost:
    """What a model costs at run time. The latent's encoder is not part of it."""

    parameters: int
    """Trained numbers of everything that a receiver runs."""
    per_object_multiply_adds: int
    """Multiply-adds of one frame of one person; biases and activations are not counted."""
    per_pixel_multiply_adds: int
    """Multiply-adds of one pixel; lookups in maps and tables are not counted."""


def pixel_codec_cost(spec: AvatarSpec) -> ModelCost:
    """The cost of a Pixel Codec Avatar: both decoders, the encoding, the two sine networks."""
    layers = [layer for name in spec.decoders for layer in decoder_layers(spec, name)]
    shapes = {n: s for n, s in spec_tensor_shapes(spec).items() if not n.startswith("encoder.")}
    shapes.pop("geometry.mean", None)  # it is measured, not trained
    networks = [shape for name, shape in shapes.items() if name.startswith(("xyz.", "pixel."))]
    return ModelCost(
        parameters=sum(map(prod, shapes.values())),
        per_object_multiply_adds=sum(layer.multiply_adds for layer in layers),
        per_pixel_multiply_adds=sum(prod(shape) for shape in networks if len(shape) == 2),
    )
