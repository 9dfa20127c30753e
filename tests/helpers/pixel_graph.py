"""The pixel decoder as an ONNX graph, for judging; the GPU runs it as GLSL.

pixel_decoder_graph(avatar)  expression [N, 4], xyz_m [N, 3], uv [N, 2] -> rgb [N, 3]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import NUM_FREQUENCIES, RGB_CHANNELS
from pica_core.graphs.graph_builder import GraphBuilder
from pica_core.types import Array


def pixel_decoder_graph(avatar: Avatar) -> bytes:
    """The pixel decoder with its encodings as an ONNX model.

    Returns:
        Serialised model over N pixels; inputs as for `pixel_reference.decode_pixels`, output
        ``rgb`` ``[N, 3]``.
    """
    graph, spec, tensors = GraphBuilder(), avatar.spec, avatar.tensors

    def siren(prefix: str, num_layers: int, value: str, *, last_is_linear: bool) -> str:
        for index in range(num_layers):
            weight, bias = (tensors[f"{prefix}.{index}.{part}"] for part in ("weight", "bias"))
            value = graph.add("Gemm", value, graph.floats(weight), graph.floats(bias), transB=1)
            if index + 1 < num_layers or not last_is_linear:
                value = graph.add("Sin", value)
        return value

    x = siren("xyz", len(spec.xyz_channels), "xyz_m", last_is_linear=False)
    surface = [_PARTS[part](graph, tensors) for part in spec.encoding_channels]
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


def _joint(graph: GraphBuilder, tensors: Mapping[str, Array]) -> str:
    u, v = (_centred(graph, axis) for axis in range(2))
    return _sample(graph, tensors["uv_encoding"], u, v)


def _axes(graph: GraphBuilder, tensors: Mapping[str, Array]) -> str:
    u, v = (_centred(graph, axis) for axis in range(2))
    zero = graph.add("Mul", u, graph.floats(0.0))
    along_u = _sample(graph, tensors["u_encoding"][None], u, zero)
    along_v = _sample(graph, tensors["v_encoding"][None], v, zero)
    return graph.add("Concat", along_u, along_v, axis=1)


def _uv(graph: GraphBuilder, tensors: Mapping[str, Array]) -> str:
    doubled = graph.add("Mul", "uv", graph.floats(2.0))
    return graph.add("Sub", doubled, graph.floats(1.0))


def _sinusoids(graph: GraphBuilder, tensors: Mapping[str, Array]) -> str:
    values: list[str] = []
    for octave in range(NUM_FREQUENCIES):
        turns = graph.add("Mul", "uv", graph.floats(float(1 << octave)))
        rest = graph.add("Sub", turns, graph.add("Floor", turns))
        angle = graph.add("Mul", rest, graph.floats(2 * np.pi))
        values += [graph.add("Sin", angle), graph.add("Cos", angle)]
    return graph.add("Concat", *values, axis=1)


_PARTS: Mapping[str, Callable[[GraphBuilder, Mapping[str, Array]], str]] = {
    "joint": _joint,
    "axes": _axes,
    "uv": _uv,
    "sinusoids": _sinusoids,
}
"""The parts of `surface_encoding`, each from the graph's input ``uv`` to ``[N, C]``."""


def _centred(graph: GraphBuilder, axis: int) -> str:
    """A coordinate in [-1, 1], ``[N]``, as GridSample takes it."""
    doubled = graph.add("Mul", "uv", graph.floats(2.0))
    centred = graph.add("Sub", doubled, graph.floats(1.0))
    return graph.add("Gather", centred, graph.constant(np.int64(axis)), axis=1)


def _sample(graph: GraphBuilder, texture: Array, x: str, y: str) -> str:
    """``[H, W, C]`` at N places -> ``[N, C]``; GridSample's default has our texel centres."""
    column = [graph.add("Reshape", value, graph.sizes(1, -1, 1, 1)) for value in (x, y)]
    grid = graph.add("Concat", *column, axis=3)
    image = graph.floats(texture.transpose(2, 0, 1)[None])
    found = graph.add("GridSample", image, grid, padding_mode="border", align_corners=0)
    rows = graph.add("Transpose", found, perm=[0, 2, 3, 1])
    return graph.add("Reshape", rows, graph.sizes(-1, texture.shape[2]))
