"""Avatar -> ONNX graphs, built here from checked numbers and never read from a file.

Two graphs, both at opset 17:

    decoder_graph(avatar)        latent [1, 8, 8, 4], view_direction [1, 3]
                                 -> position_map [S, S, 3] metres, expression_map [S, S, 4]
    pixel_decoder_graph(avatar)  expression [N, 4], xyz_m [N, 3], uv [N, 2] -> rgb [N, 3]

The decoders are the layers of `decoder_layers`, one chain each, in one graph. `plain=True` writes
them as they stand. The default graph computes the same function, rearranged for ONNX Runtime's CPU
kernels; each step was measured on one thread of an AVX-512 machine (block C: 2.6 ms plain, 1.0 ms
rearranged; B and H2 gain nothing):

- *Expand + pixel shuffle = transposed convolution 2x2, stride 2.* DepthToSpace moves single floats
  and took 40 % of the time; the transposed convolution writes the shuffled result at once (8
  channels at 64x64: 190 -> 65 us). Its bias is per channel, the expand's per channel and phase:
  that rides on one more input channel, constantly 1.
- *Convolution 3x3 = transposed convolution 3x3 with the kernel turned round.* MLAS unfolds the
  input of a convolution (9 * in values a pixel) but folds the output of a transposed one (9 * out):
  better when few channels come out (8 -> 3 at 128x128: 230 -> 90 us), so it is used there, from
  64x64 on.
- Scale and mean of the geometry are folded: the scale into the last weights, its last bias into the
  mean.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper, numpy_helper

from pica_core.avatar_file import Avatar
from pica_core.decoder_layers import Layer, decoder_layers
from pica_core.spec import (
    LATENT_SHAPE,
    LATENT_SIZE,
    LEAKY_SLOPE,
    RGB_CHANNELS,
    VIEW_CHANNELS,
)

OPSET = 17
"""Newer operator sets lack ONNX Runtime's fused CPU kernels for some of what we use."""
IR_VERSION = 8
TURN_CONVOLUTION_SIZE = 64
"""From this many rows on a narrowing 3x3 convolution is written as a transposed one."""

Array = npt.NDArray[Any]


@dataclass(slots=True)
class _Graph:
    """Nodes and initialisers under construction. Values are named by the node that makes them."""

    nodes: list[onnx.NodeProto] = field(default_factory=list)
    initialisers: list[onnx.TensorProto] = field(default_factory=list)

    def constant(self, array: npt.ArrayLike) -> str:
        name = f"constant_{len(self.initialisers)}"
        values = np.ascontiguousarray(array)
        self.initialisers.append(numpy_helper.from_array(values, name))
        return name

    def floats(self, array: npt.ArrayLike) -> str:
        return self.constant(np.asarray(array, np.float32))

    def sizes(self, *sizes: int) -> str:
        return self.constant(np.array(sizes, np.int64))

    def add(self, operator: str, *inputs: str, output: str | None = None, **attributes: Any) -> str:
        name = f"{operator}_{len(self.nodes)}"
        made = output or f"{name}_out"
        self.nodes.append(helper.make_node(operator, inputs, [made], name=name, **attributes))
        return made

    def serialise(
        self, inputs: dict[str, list[int | str]], outputs: dict[str, list[int | str]]
    ) -> bytes:
        def infos(shapes: dict[str, list[int | str]]) -> list[onnx.ValueInfoProto]:
            return [
                helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
                for name, shape in shapes.items()
            ]

        graph = helper.make_graph(
            self.nodes, "pica", infos(inputs), infos(outputs), self.initialisers
        )
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
        )
        serialised: bytes = model.SerializeToString()
        return serialised


def decoder_graph(avatar: Avatar, *, plain: bool = False) -> bytes:
    """The two per-object decoders as one ONNX model.

    Args:
        avatar: Checked avatar of any block.
        plain: Write the layers as they stand, one operator each; the judge of the rearranged graph.

    Returns:
        Serialised model; inputs and outputs as in the module's text, float32, channel-last.
    """
    graph = _Graph()
    grid = graph.add("Transpose", "latent", perm=[0, 3, 1, 2])
    view = graph.add("Reshape", "view_direction", graph.sizes(1, VIEW_CHANNELS, 1, 1))
    tiled = graph.add("Expand", view, graph.sizes(1, VIEW_CHANNELS, LATENT_SIZE, LATENT_SIZE))
    inputs = {"geometry": grid, "expression": graph.add("Concat", grid, tiled, axis=1)}
    size = avatar.spec.map_size
    tensors = {name: np.asarray(array) for name, array in avatar.tensors.items()}
    if not plain:
        _fold_position_scale(avatar, tensors)
    for decoder, value in inputs.items():
        layers = decoder_layers(avatar.spec, decoder)
        arrange = _plain if plain else _fast
        value = arrange(graph, layers, tensors, value)
        channels = layers[-1].out_channels
        last = graph.add("Transpose", value, perm=[0, 2, 3, 1])
        shape = graph.sizes(size, size, channels)
        if decoder == "expression":
            graph.add("Reshape", last, shape, output="expression_map")
            continue
        flat = graph.add("Reshape", last, shape)
        if plain:
            flat = graph.add("Mul", flat, graph.floats(avatar.manifest.position_scale_m))
        graph.add("Add", flat, graph.floats(tensors["geometry.mean"]), output="position_map")
    return graph.serialise(
        {"latent": [1, *LATENT_SHAPE], "view_direction": [1, VIEW_CHANNELS]},
        {
            "position_map": [size, size, 3],
            "expression_map": [size, size, avatar.spec.expression_channels],
        },
    )


def _plain(graph: _Graph, layers: list[Layer], tensors: dict[str, Array], value: str) -> str:
    for layer in layers:
        weights = [graph.floats(tensors[name]) for name in layer.tensor_shapes()]
        match layer.kind:
            case "conv3" | "conv1":
                edge = 1 if layer.kind == "conv3" else 0
                value = graph.add("Conv", value, *weights, pads=[edge] * 4)
            case "deconv4":
                value = graph.add("ConvTranspose", value, *weights, strides=[2, 2], pads=[1] * 4)
            case "untied_bias":
                value = graph.add("Add", value, *weights)
            case "leaky_relu":
                value = graph.add("LeakyRelu", value, alpha=LEAKY_SLOPE)
            case "pixel_shuffle":
                value = graph.add("DepthToSpace", value, blocksize=2, mode="CRD")
    return value


def _fast(graph: _Graph, layers: list[Layer], tensors: dict[str, Array], value: str) -> str:
    for layer, following in zip(layers, [*layers[1:], None], strict=True):
        weights = [tensors[name] for name in layer.tensor_shapes()]
        match layer.kind:
            case "conv3" if (
                layer.size >= TURN_CONVOLUTION_SIZE and layer.out_channels < layer.in_channels
            ):
                turned = weights[0][:, :, ::-1, ::-1].transpose(1, 0, 2, 3)
                bias = [graph.floats(array) for array in weights[1:]]
                value = graph.add("ConvTranspose", value, graph.floats(turned), *bias, pads=[1] * 4)
            case "conv1" if following is not None and following.kind == "pixel_shuffle":
                value = _expand_and_shuffle(graph, layer, weights, value)
            case "pixel_shuffle":
                pass
            case _:
                value = _plain(graph, [layer], tensors, value)
    return value


def _expand_and_shuffle(graph: _Graph, layer: Layer, weights: list[Array], value: str) -> str:
    """``conv1`` to 4c channels and the pixel shuffle after it, as one transposed convolution."""
    c_in, c_out = layer.in_channels, layer.out_channels // 4
    # Channel 4c + 2y + x of the expand lands on row y, column x of output channel c.
    kernel = weights[0].reshape(c_out, 2, 2, c_in).transpose(3, 0, 1, 2)
    bias = weights[1].reshape(1, c_out, 2, 2)
    if np.any(bias):
        ones = graph.floats(np.ones((1, 1, layer.size, layer.size)))
        value = graph.add("Concat", value, ones, axis=1)
        kernel = np.concatenate([kernel, bias])
    return graph.add("ConvTranspose", value, graph.floats(kernel), strides=[2, 2])


def _fold_position_scale(avatar: Avatar, tensors: dict[str, Array]) -> None:
    """Move the geometry's scale into its last layer, and that layer's bias into the mean."""
    layers = [layer for layer in decoder_layers(avatar.spec, "geometry") if layer.tensor_shapes()]
    weight, bias = f"{layers[-1].name}.weight", f"{layers[-1].name}.bias"
    scale = np.float64(avatar.manifest.position_scale_m)
    tensors[weight] = tensors[weight] * scale
    offset = tensors[bias] * scale
    tensors[bias] = np.zeros_like(tensors[bias])
    mean = tensors["geometry.mean"].astype(np.float64)
    if avatar.spec.block == "C":  # four phases per channel, as `_expand_and_shuffle` says
        phases = offset.reshape(-1, 2, 2).transpose(1, 2, 0)
        half = avatar.spec.map_size // 2
        mean = mean + np.tile(phases, (half, half, 1))
    else:
        mean = mean + offset
    tensors["geometry.mean"] = mean


def pixel_decoder_graph(avatar: Avatar) -> bytes:
    """The pixel decoder with its encodings as an ONNX model, for judging; the GPU runs it as GLSL.

    Returns:
        Serialised model over N pixels; inputs as for `pixel_reference.decode_pixels`, output
        ``rgb`` ``[N, 3]``.
    """
    graph, spec, tensors = _Graph(), avatar.spec, avatar.tensors
    minus_one_to_one = graph.add(
        "Sub", graph.add("Mul", "uv", graph.floats(2.0)), graph.floats(1.0)
    )
    u = graph.add("Gather", minus_one_to_one, graph.constant(np.int64(0)), axis=1)
    v = graph.add("Gather", minus_one_to_one, graph.constant(np.int64(1)), axis=1)
    zero = graph.add("Mul", u, graph.floats(0.0))

    def sample(texture: Array, x: str, y: str) -> str:
        """``[H, W, C]`` at N places -> ``[N, C]``; GridSample's default has our texel centres."""
        column = [graph.add("Reshape", value, graph.sizes(1, -1, 1, 1)) for value in (x, y)]
        grid = graph.add("Concat", *column, axis=3)
        image = graph.floats(texture.transpose(2, 0, 1)[None])
        found = graph.add("GridSample", image, grid, padding_mode="border", align_corners=0)
        rows = graph.add("Transpose", found, perm=[0, 2, 3, 1])
        return graph.add("Reshape", rows, graph.sizes(-1, texture.shape[2]))

    def siren(prefix: str, num_layers: int, value: str, *, last_is_linear: bool) -> str:
        for index in range(num_layers):
            weight, bias = (tensors[f"{prefix}.{index}.{part}"] for part in ("weight", "bias"))
            value = graph.add("Gemm", value, graph.floats(weight), graph.floats(bias), transB=1)
            if index + 1 < num_layers or not last_is_linear:
                value = graph.add("Sin", value)
        return value

    x = siren("xyz", len(spec.xyz_channels), "xyz_m", last_is_linear=False)
    surface = [
        sample(tensors["uv_encoding"], u, v),
        sample(tensors["u_encoding"][None], u, zero),
        sample(tensors["v_encoding"][None], v, zero),
    ]
    p = graph.add("Concat", "expression", x, *surface, axis=1)
    rgb = siren("pixel", len(spec.pixel_channels), p, last_is_linear=True)
    graph.add("Identity", rgb, output="rgb")
    return graph.serialise(
        {
            "expression": ["N", spec.expression_channels],
            "xyz_m": ["N", 3],
            "uv": ["N", 2],
        },
        {"rgb": ["N", RGB_CHANNELS]},
    )
