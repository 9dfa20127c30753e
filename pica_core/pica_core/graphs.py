"""Avatar -> ONNX graph of its decoders, built here from checked numbers and never read from a file.

    decoder_graph(avatar)                       latent [1, 8, 8, 4], view_direction [1, 3]
                                                -> position_map [S, S, 3] metres,
                                                   expression_map [S, S, 4]
    decoder_graph(avatar, level=64)             the same, left at an early exit; its position map is
                                                the sheet of its vertices, [R, S, 3]
    decoder_graph(avatar, positions=False)      the expression map alone

The decoders are the layers of `decoder_layers`, one chain each, in one graph at opset 17,
rearranged for ONNX Runtime's CPU kernels: both full maps in 2.2 ms instead of 6.1 on one thread of
AVX-512, and at level 64 in 0.6 instead of 1.2 (H2 gains nothing):

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
- A map is reshaped before its last transpose, not after: a reshape that makes an output is a copy.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper, numpy_helper

from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import local_name, spread_local
from pica_core.avatar.linear import PREFIX as LINEAR_PREFIX
from pica_core.avatar.linear import RANK, REGION, components_of
from pica_core.avatar.spec import (
    EXPRESSION_CHANNELS,
    LEAKY_SLOPE,
    MAP_SIZE,
    POSITION_CHANNELS,
    RGB_CHANNELS,
    VIEW_CHANNELS,
    Layer,
    LayerKind,
    decoder_layers,
    trunk_layers,
)
from pica_core.reference import FIRST_SIZE, BaselineAvatar
from pica_core.types import LATENT_SHAPE, LATENT_SIZE, NUM_LATENT, Array

OPSET = 17
"""Newer operator sets lack ONNX Runtime's fused CPU kernels for some of what we use."""
IR_VERSION = 8

Shape = list[int | str]


@dataclass(slots=True)
class GraphBuilder:
    """Nodes and initialisers under construction. Values are named by the node that makes them."""

    nodes: list[onnx.NodeProto] = field(default_factory=list)
    initialisers: list[onnx.TensorProto] = field(default_factory=list)

    def constant(self, array: npt.ArrayLike) -> str:
        """A constant of the array's own type."""
        name = f"constant_{len(self.initialisers)}"
        values = np.ascontiguousarray(array)
        self.initialisers.append(numpy_helper.from_array(values, name))
        return name

    def floats(self, array: npt.ArrayLike) -> str:
        """A constant in float32."""
        return self.constant(np.asarray(array, np.float32))

    def sizes(self, *sizes: int) -> str:
        """A constant list of int64, as shapes and axes are."""
        return self.constant(np.array(sizes, np.int64))

    def add(self, operator: str, *inputs: str, output: str | None = None, **attributes: Any) -> str:
        """Add a node with one output and return that value's name."""
        name = f"{operator}_{len(self.nodes)}"
        made = output or f"{name}_out"
        self.nodes.append(helper.make_node(operator, inputs, [made], name=name, **attributes))
        return made

    def serialise(self, inputs: dict[str, Shape], outputs: dict[str, Shape]) -> bytes:
        """The model with float32 inputs and outputs of these names and shapes."""

        def infos(shapes: dict[str, Shape]) -> list[onnx.ValueInfoProto]:
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
        return model.SerializeToString()


TURN_CONVOLUTION_SIZE = 64
"""Rows from which on a narrowing 3x3 convolution is written as a transposed one."""

RANK_STEP = 4
"""Regions of about one rank are multiplied together, ranks filled up to multiples of this with
directions that are 0: a product of its own for each of a hundred regions would cost more in calls
than in arithmetic."""

_OPERATORS: dict[LayerKind, tuple[str, dict[str, Any]]] = {
    "conv3": ("Conv", {"pads": [1] * 4}),
    "deconv4": ("ConvTranspose", {"strides": [2, 2], "pads": [1] * 4}),
    "untied_bias": ("Add", {}),
    "untied_gain": ("Mul", {}),
}


def decoder_graph(avatar: Avatar, *, level: int | None = None, positions: bool = True) -> bytes:
    """The per-object decoders as one ONNX model.

    Args:
        level: One of `avatar.levels`; None for the full one.
        positions: Make the position map, too.

    Returns:
        Serialised model; inputs and outputs as in the module's text, float32, channel-last.

    Raises:
        ValueError: The avatar does not have this level.
    """
    size = MAP_SIZE if level is None else level
    avatar.level_faces(size)  # refuses a level that is not there
    graph = GraphBuilder()
    grid = graph.add("Transpose", "latent", perm=[0, 3, 1, 2])
    inputs: dict[str, Shape] = {"latent": [1, *LATENT_SHAPE], "view_direction": [1, VIEW_CHANNELS]}
    outputs: dict[str, Shape] = {}
    if positions:
        add = _bases if avatar.spec.geometry == "bases" else _position_map
        add(graph, avatar, size, grid)
        outputs["position_map"] = [avatar.position_rows(size), size, POSITION_CHANNELS]
    view = graph.add("Reshape", "view_direction", graph.sizes(1, VIEW_CHANNELS, 1, 1))
    tiled = graph.add("Expand", view, graph.sizes(1, VIEW_CHANNELS, LATENT_SIZE, LATENT_SIZE))
    trunk, last, tensors = _expression(avatar, size)
    found = _chain(graph, trunk, tensors, graph.add("Concat", grid, tiled, axis=1))
    value = _chain(graph, last, tensors, found)
    if local_name(size) in tensors:  # what each block of texels adds by weights of its own
        own = graph.floats(spread_local(tensors[local_name(size)]))
        weighed = graph.add("Mul", found, own)
        added = graph.add("ReduceSum", weighed, graph.sizes(1), keepdims=0)
        value = graph.add("Add", value, added)
    _channel_last(graph, value, size, EXPRESSION_CHANNELS, output="expression_map")
    outputs["expression_map"] = [size, size, EXPRESSION_CHANNELS]
    return graph.serialise(inputs, outputs)


def _position_map(graph: GraphBuilder, avatar: Avatar, size: int, grid: str) -> None:
    """The geometry decoder with the scale in its last weights, the bias of its last layer in the
    mean."""
    tensors, scale = dict(avatar.tensors), np.float64(avatar.manifest.position_scale_m)
    mean, layers = tensors["geometry.mean"], decoder_layers(avatar.spec, "geometry")
    last = [layer for layer in layers if layer.tensor_shapes()][-1]
    tensors[f"{last.name}.weight"] = tensors[f"{last.name}.weight"] * scale
    if last.has_bias:
        bias = f"{last.name}.bias"
        offset = tensors[bias] * scale
        tensors[bias] = np.zeros_like(tensors[bias])
        if last.kind == "conv1":  # four phases per channel, as `_expand_and_shuffle` says
            phases = offset.reshape(-1, 2, 2).transpose(1, 2, 0)
            offset = np.tile(phases, (size // 2, size // 2, 1))
        mean = mean.astype(np.float64) + offset
    value = _channel_last(graph, _chain(graph, layers, tensors, grid), size, POSITION_CHANNELS)
    graph.add("Add", value, graph.floats(mean), output="position_map")


def _expression(avatar: Avatar, size: int) -> tuple[list[Layer], list[Layer], dict[str, Array]]:
    """Layers of the expression decoder at a level and of its exit there, and their tensors."""
    tensors = dict(avatar.tensors)
    if size == MAP_SIZE:
        return decoder_layers(avatar.spec, "expression"), [], tensors
    name = f"level.{size}.expression"
    out_channels, in_channels = tensors[f"{name}.weight"].shape[:2]
    last = Layer("conv3", name, in_channels, out_channels, size)
    bias = Layer("untied_bias", f"{name}.untied", out_channels, out_channels, size)
    tensors[f"{bias.name}.weight"] = tensors[f"{name}.bias"]
    return trunk_layers(avatar.spec, size), [last, bias], tensors


def _channel_last(
    graph: GraphBuilder, value: str, size: int, channels: int, output: str | None = None
) -> str:
    # Reshaped first: a reshape that makes an output is a copy.
    planes = graph.add("Reshape", value, graph.sizes(channels, size, size))
    return graph.add("Transpose", planes, perm=[1, 2, 0], output=output)


def _chain(graph: GraphBuilder, layers: list[Layer], tensors: dict[str, Array], value: str) -> str:
    for layer in layers:
        weights = [tensors[name] for name in layer.tensor_shapes()]
        is_narrowing = layer.out_channels < layer.in_channels
        match layer.kind:
            case "conv3" if is_narrowing and layer.size >= TURN_CONVOLUTION_SIZE:
                turned = weights[0][:, :, ::-1, ::-1].transpose(1, 0, 2, 3)
                constants = [graph.floats(array) for array in (turned, *weights[1:])]
                value = graph.add("ConvTranspose", value, *constants, pads=[1] * 4)
            case "conv1":  # a pixel shuffle follows
                value = _expand_and_shuffle(graph, layer, weights, value)
            case "pixel_shuffle":
                pass
            case "leaky_relu":
                value = graph.add("LeakyRelu", value, alpha=LEAKY_SLOPE)
            case _:
                operator, attributes = _OPERATORS[layer.kind]
                constants = [graph.floats(array) for array in weights]
                value = graph.add(operator, value, *constants, **attributes)
    return value


def _expand_and_shuffle(graph: GraphBuilder, layer: Layer, weights: list[Array], value: str) -> str:
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


def _bases(graph: GraphBuilder, avatar: Avatar, size: int, _: str) -> None:
    """Vertices by a few products of matrices."""
    tensors, scale_m = avatar.tensors, avatar.manifest.position_scale_m
    flat = graph.add("Reshape", "latent", graph.sizes(1, NUM_LATENT))
    weight, bias = (graph.floats(tensors[f"{LINEAR_PREFIX}{part}"]) for part in ("weight", "bias"))
    weights = graph.add("Gemm", flat, weight, bias, transB=1)
    rows = avatar.position_rows(size)
    if size == MAP_SIZE:
        moved = _by_regions(graph, tensors, scale_m, weights)
        mean = tensors[f"{LINEAR_PREFIX}mean"]
    else:
        places = avatar.sheet_places(size)
        whole = components_of(tensors, scale_m, places)
        mean = tensors[f"{LINEAR_PREFIX}mean"].reshape(-1, POSITION_CHANNELS)[places]
        moved = graph.add("MatMul", weights, graph.floats(whole.reshape(len(whole), -1)))
    moved = graph.add("Reshape", moved, graph.sizes(rows, size, POSITION_CHANNELS))
    mean = mean.reshape(rows, size, POSITION_CHANNELS)
    graph.add("Add", moved, graph.floats(mean), output="position_map")


def _by_regions(
    graph: GraphBuilder, tensors: Mapping[str, Array], scale_m: float, weights: str
) -> str:
    rank, mix, basis = (
        tensors[RANK],
        tensors[f"{LINEAR_PREFIX}mix"],
        tensors[f"{LINEAR_PREFIX}basis"],
    )
    starts = np.cumsum(rank) - rank
    filled = -(-rank // RANK_STEP) * RANK_STEP
    pieces = []
    first = 0
    for last in [*(np.flatnonzero(np.diff(filled)) + 1).tolist(), len(filled)]:
        count, most = last - first, int(filled[first])
        columns = REGION * POSITION_CHANNELS
        if most:
            local = np.zeros((count, most, mix.shape[1]), np.float32)
            offsets = np.zeros((count, most, columns), np.float32)
            for row in range(count):
                part = slice(starts[first + row], starts[first + row] + rank[first + row])
                local[row, : rank[first + row]] = scale_m * mix[part]
                offsets[row, : rank[first + row]] = basis[part].reshape(-1, columns)
            value = graph.add("MatMul", weights, graph.floats(local.reshape(-1, mix.shape[1]).T))
            value = graph.add("Reshape", value, graph.sizes(count, 1, most))
            value = graph.add("MatMul", value, graph.floats(offsets))
            pieces.append(graph.add("Reshape", value, graph.sizes(1, count * columns)))
        else:
            pieces.append(graph.floats(np.zeros((1, count * columns))))
        first = last
    return graph.add("Concat", *pieces, axis=1)


def baseline_graph(baseline: BaselineAvatar) -> bytes:
    """The baseline's decoder with its layers as they stand, one operator each: of ``latent`` [1,
    256] and ``view_direction`` [1, 3] ``vertices`` [V, 3] in metres and ``texture`` [T, T, 3].

    Fully connected layers are Gemms with the weights as they stand; convolutions are transposed
    convolutions with an Add for the untied bias.

    Returns:
        Serialised model, float32; the texture is sRGB with 1.0 white, row 0 is v = 0, not clamped.
    """
    graph, spec, tensors = GraphBuilder(), baseline.spec, baseline.tensors

    def connect(name: str, value: str) -> str:
        weight, bias = (graph.floats(tensors[f"{name}.{part}"]) for part in ("weight", "bias"))
        return graph.add("Gemm", value, weight, bias, transB=1)

    def leaky(value: str) -> str:
        return graph.add("LeakyRelu", value, alpha=LEAKY_SLOPE)

    code = leaky(connect("latent", "latent"))
    vertices = connect("mesh", code)
    shape = graph.sizes(spec.num_vertices, 3)
    graph.add("Reshape", vertices, shape, output="vertices")
    view = leaky(connect("view", "view_direction"))
    value = leaky(connect("grid", graph.add("Concat", code, view, axis=1)))
    shape = graph.sizes(1, spec.num_latent, FIRST_SIZE, FIRST_SIZE)
    value = graph.add("Reshape", value, shape)
    for index in range(len(spec.channels)):
        weight = graph.floats(tensors[f"texture.{index}.weight"])
        value = graph.add("ConvTranspose", value, weight, strides=[2, 2], pads=[1] * 4)
        value = graph.add("Add", value, graph.floats(tensors[f"texture.{index}.bias"][None]))
        if index + 1 < len(spec.channels):
            value = leaky(value)
    size = spec.texture_size
    last = graph.add("Transpose", value, perm=[0, 2, 3, 1])
    graph.add("Reshape", last, graph.sizes(size, size, RGB_CHANNELS), output="texture")
    return graph.serialise(
        {"latent": [1, spec.num_latent], "view_direction": [1, VIEW_CHANNELS]},
        {"vertices": [spec.num_vertices, 3], "texture": [size, size, RGB_CHANNELS]},
    )
