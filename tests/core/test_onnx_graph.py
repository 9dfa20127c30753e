"""The ONNX graphs compute what the list of layers says, in any arrangement."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime
import pytest

import tolerances
from pica_core.avatar_file import Avatar
from pica_core.decoder_layers import decoder_layers
from pica_core.onnx_graph import decoder_graph, pixel_decoder_graph
from pica_core.pixel_reference import decode_pixels
from pica_core.spec import BLOCKS, LEAKY_SLOPE, AvatarSpec
from toy import make_toy_avatar

pytestmark = pytest.mark.unit

Array = npt.NDArray[Any]


@functools.cache
def toy(block: str) -> Avatar:
    return make_toy_avatar(
        spec=AvatarSpec(block=block, uv_encoding_size=16, axis_encoding_size=20), grid=4
    )


def run(model: bytes, **inputs: Array) -> list[Array]:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    feeds = {name: array.astype(np.float32) for name, array in inputs.items()}
    outputs: list[Array] = session.run(None, feeds)
    return outputs


def some_inputs(seed: int = 1) -> dict[str, Array]:
    rng = np.random.default_rng(seed)
    view = rng.standard_normal((1, 3)) + np.array([0, 0, 3])
    return {
        "latent": rng.standard_normal((1, 8, 8, 4)),
        "view_direction": view / np.linalg.norm(view),
    }


def convolve(image: Array, weight: Array) -> Array:
    """3x3 or 1x1 convolution of ``[C, H, W]`` with zero padding, float64, written for reading."""
    _, rows, columns = image.shape
    edge = weight.shape[2] // 2
    padded = np.pad(image, ((0, 0), (edge, edge), (edge, edge)))
    total = np.zeros((weight.shape[0], rows, columns))
    for y in range(weight.shape[2]):
        for x in range(weight.shape[3]):
            shifted = padded[:, y : y + rows, x : x + columns]
            total += np.tensordot(weight[:, :, y, x].astype(np.float64), shifted, axes=1)
    return total


def deconvolve(image: Array, weight: Array) -> Array:
    """Transposed convolution 4x4, stride 2, padding 1: every input spreads over 4x4 outputs."""
    _, rows, columns = image.shape
    spread = np.zeros((weight.shape[1], 2 * rows + 2, 2 * columns + 2))
    for y in range(4):
        for x in range(4):
            part = np.tensordot(weight[:, :, y, x].T.astype(np.float64), image, axes=1)
            spread[:, y : y + 2 * rows : 2, x : x + 2 * columns : 2] += part
    return spread[:, 1:-1, 1:-1]


def interpret(avatar: Avatar, decoder: str, grid: Array) -> Array:
    """Run a decoder's layers in float64."""
    value = grid
    for layer in decoder_layers(avatar.spec, decoder):
        weights = [avatar.tensors[name] for name in layer.tensor_shapes()]
        match layer.kind:
            case "conv3" | "conv1":
                value = convolve(value, weights[0])
            case "deconv4":
                value = deconvolve(value, weights[0])
            case "untied_bias":
                value = value + weights[0]
            case "leaky_relu":
                value = np.where(value > 0, value, LEAKY_SLOPE * value)
            case "pixel_shuffle":
                phases = value.reshape(-1, 2, 2, *value.shape[1:]).transpose(0, 3, 1, 4, 2)
                value = phases.reshape(layer.out_channels, layer.size, layer.size)
        if layer.has_bias:
            value = value + weights[1][:, None, None]
        assert value.shape == (layer.out_channels, layer.size, layer.size)
    return value


def decode_in_numpy(avatar: Avatar, latent: Array, view_direction: Array) -> tuple[Array, Array]:
    grid = latent[0].transpose(2, 0, 1)
    view = np.tile(view_direction[0][:, None, None], (1, 8, 8))
    geometry = interpret(avatar, "geometry", grid).transpose(1, 2, 0)
    expression = interpret(avatar, "expression", np.concatenate([grid, view]))
    mean = avatar.tensors["geometry.mean"]
    return mean + avatar.manifest.position_scale_m * geometry, expression.transpose(1, 2, 0)


@pytest.mark.parametrize("plain", [True, False], ids=["plain", "rearranged"])
@pytest.mark.parametrize("block", BLOCKS)
def test_the_decoder_graph_agrees_with_its_layers_run_in_numpy(block: str, plain: bool) -> None:
    avatar, inputs = toy(block), some_inputs()
    position_map, expression_map = run(decoder_graph(avatar, plain=plain), **inputs)
    positions, expressions = decode_in_numpy(avatar, **inputs)
    assert position_map.shape == (256, 256, 3)
    assert expression_map.shape == (256, 256, 4)
    assert np.abs(position_map - positions).max() < tolerances.MAP_ONNX_M
    assert np.abs(expression_map - expressions).max() < tolerances.EXPRESSION_ONNX


@pytest.mark.parametrize("block", BLOCKS)
def test_the_graph_is_valid_onnx_of_an_old_operator_set(block: str) -> None:
    model = onnx.load_from_string(decoder_graph(toy(block)))
    onnx.checker.check_model(model, full_check=True)
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", 17)]


def test_the_rearranged_graph_shuffles_no_pixels_and_scales_no_map() -> None:
    operators = {n.op_type for n in onnx.load_from_string(decoder_graph(toy("C"))).graph.node}
    assert not operators & {"DepthToSpace", "Mul"}


def test_the_view_direction_changes_the_expression_map_alone() -> None:
    graph, inputs = decoder_graph(toy("C")), some_inputs()
    before = run(graph, **inputs)
    after = run(graph, latent=inputs["latent"], view_direction=np.array([[0.6, 0.0, 0.8]]))
    np.testing.assert_array_equal(before[0], after[0])
    assert np.abs(before[1] - after[1]).max() > 1e-3


@pytest.mark.parametrize("value", [np.nan, 1e30])
def test_a_hopeless_latent_decodes_to_maps_of_the_right_shape(value: float) -> None:
    inputs = some_inputs()
    inputs["latent"][:] = value
    position_map, expression_map = run(decoder_graph(toy("C")), **inputs)
    assert position_map.shape == (256, 256, 3)
    assert expression_map.shape == (256, 256, 4)


def test_the_pixel_decoder_graph_agrees_with_numpy() -> None:
    avatar = make_toy_avatar(spec=AvatarSpec(uv_encoding_size=64), grid=4)
    rng = np.random.default_rng(2)
    pixels = {
        "expression": rng.standard_normal((5000, 4)),
        "xyz_m": rng.uniform(-0.1, 0.1, (5000, 3)),
        "uv": np.concatenate([rng.uniform(0, 1, (4996, 2)), [[0, 0], [1, 1], [0, 1], [1, 0]]]),
    }
    pixels = {name: array.astype(np.float32) for name, array in pixels.items()}
    (rgb,) = run(pixel_decoder_graph(avatar), **pixels)
    wanted = decode_pixels(avatar.spec, avatar.tensors, *pixels.values(), np.float64)
    assert np.abs(rgb - wanted).max() < tolerances.PIXEL_ONNX
