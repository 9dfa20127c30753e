"""The ONNX graphs compute what the list of layers says, in any arrangement."""

from __future__ import annotations

import functools

import numpy as np
import onnx
import pytest

from helpers import tolerances
from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.decode.decoder import onnxruntime
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import BLOCKS, AvatarSpec
from pica_core.graphs import decoder_graph
from pica_core.reference import decode_expression_map, decode_position_map
from pica_core.types import Array

pytestmark = [pytest.mark.unit, pytest.mark.slow]


@functools.cache
def toy(block: str) -> Avatar:
    spec = AvatarSpec(block=block, uv_encoding_size=16, axis_encoding_size=20)
    return make_toy_avatar(spec=spec, grid=4)


@functools.cache
def levelled(block: str) -> Avatar:
    return with_toy_levels(toy(block))


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


def decode_in_numpy(
    avatar: Avatar, latent: Array, view_direction: Array, level: int | None = None
) -> tuple[Array, Array]:
    position_map = decode_position_map(avatar, latent[0], level)
    return position_map, decode_expression_map(avatar, latent[0], view_direction[0], level)


@pytest.mark.parametrize("block", BLOCKS)
def test_the_decoder_graph_agrees_with_its_layers_run_in_numpy(block: str) -> None:
    avatar, inputs = toy(block), some_inputs()
    position_map, expression_map = run(decoder_graph(avatar), **inputs)
    positions, expressions = decode_in_numpy(avatar, **inputs)
    assert position_map.shape == (256, 256, 3)
    assert expression_map.shape == (256, 256, 4)
    assert np.abs(position_map - positions).max() < tolerances.MAP_ONNX_M
    assert np.abs(expression_map - expressions).max() < tolerances.EXPRESSION_ONNX


@pytest.mark.parametrize("level", [64, 128])
@pytest.mark.parametrize("block", BLOCKS)
def test_an_early_exit_agrees_with_its_layers_run_in_numpy(block: str, level: int) -> None:
    avatar, inputs = levelled(block), some_inputs()
    position_map, expression_map = run(decoder_graph(avatar, level=level), **inputs)
    positions, expressions = decode_in_numpy(avatar, **inputs, level=level)
    assert position_map.shape == (1, level, 3)
    assert expression_map.shape == (level, level, 4)
    assert np.abs(position_map - positions).max() < tolerances.MAP_ONNX_M
    assert np.abs(expression_map - expressions).max() < tolerances.EXPRESSION_ONNX
    (alone,) = run(decoder_graph(avatar, level=level, positions=False), **inputs)
    assert np.abs(alone - expression_map).max() < tolerances.EXPRESSION_ONNX


def test_a_level_that_the_avatar_lacks_has_no_graph() -> None:
    with pytest.raises(ValueError, match="level is 64; this avatar has 256"):
        decoder_graph(toy("G"), level=64)


@pytest.mark.parametrize("block", BLOCKS)
def test_the_graph_is_valid_onnx_of_an_old_operator_set(block: str) -> None:
    model = onnx.load_from_string(decoder_graph(toy(block)))
    onnx.checker.check_model(model, full_check=True)
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", 17)]


def test_the_view_direction_changes_the_expression_map_alone() -> None:
    graph, inputs = decoder_graph(toy("G")), some_inputs()
    before = run(graph, **inputs)
    after = run(graph, latent=inputs["latent"], view_direction=np.array([[0.6, 0.0, 0.8]]))
    np.testing.assert_array_equal(before[0], after[0])
    assert np.abs(before[1] - after[1]).max() > 1e-3
