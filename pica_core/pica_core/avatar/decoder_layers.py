"""The per-object decoders as a list of plain layers: one description for torch and ONNX alike.

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
"""

from dataclasses import dataclass
from typing import Literal

from pica_core.avatar.spec import AvatarSpec
from pica_core.latent import LATENT_SIZE

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
    in_channels, outputs = spec.decoder_channels[decoder]
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
    """Name and shape of every tensor that the spec fixes: all but mesh and expression encoder."""
    shapes: dict[str, tuple[int, ...]] = {}
    if spec.geometry == "decoder":
        shapes["geometry.mean"] = (spec.map_size, spec.map_size, 3)
    for decoder in spec.decoder_channels:
        for layer in decoder_layers(spec, decoder):
            shapes.update(layer.tensor_shapes())
    shapes |= spec.encoding_shapes
    for prefix, width, outputs in (
        ("xyz", 3, spec.xyz_channels),
        ("pixel", spec.pixel_input_channels, spec.pixel_channels),
    ):
        for index, out in enumerate(outputs):
            shapes[f"{prefix}.{index}.weight"] = (out, width)
            shapes[f"{prefix}.{index}.bias"] = (out,)
            width = out
    return shapes


def trunk_layers(spec: AvatarSpec, decoder: str, level: int) -> list[Layer]:
    """The layers of a decoder that lead to maps of `level` rows, up to the LeakyReLU after them;
    ValueError if no block but the last makes such maps."""
    name = f"{decoder}.{_block_of(spec, level)}.out"
    layers = decoder_layers(spec, decoder)
    return layers[: [layer.name for layer in layers].index(name) + 1]


def trunk_channels(spec: AvatarSpec, level: int) -> int:
    """Channels that an early exit at `level` rows finds, the same in both decoders; ValueError as
    `trunk_layers`."""
    return spec.hidden_channels[_block_of(spec, level)]


def _block_of(spec: AvatarSpec, level: int) -> int:
    sizes = [LATENT_SIZE << (index + 1) for index in range(len(spec.hidden_channels))]
    if level not in sizes:
        raise ValueError(f"level is {level}; trunks can be left at {', '.join(map(str, sizes))}")
    return sizes.index(level)


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
