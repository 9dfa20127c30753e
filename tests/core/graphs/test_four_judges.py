"""One model, several implementations: torch and ONNX against the numpy reference.

The fourth, GLSL, is judged on the same footing in `tests/client/render`, where there is a GL
context. Tolerances and their reasons stand in `tests/helpers/tolerances.py`.
"""

import functools

import numpy as np
import onnx
import pytest
import torch

from helpers.tolerances import EXPRESSION_ONNX, MAP_ONNX_M, MAP_TORCH_M
from helpers.toy import make_toy_avatar, with_toy_levels
from helpers.trainable import exported, toy_prior
from pica_client.decode.decoder import onnxruntime
from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import local_name
from pica_core.avatar.spec import BLOCKS, EXPRESSION_CHANNELS, AvatarSpec
from pica_core.graphs import decoder_graph
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.model.interface import ModelOptions
from pica_core.reference import decode_expression_map, decode_position_map
from pica_core.train.lod.exits import FaceSet, FrozenDecoder, MapExit
from pica_core.types import Array

pytestmark = pytest.mark.train


def trained_looking_model(block: str) -> PixelCodecAvatar:
    """Random weights as large as trained ones: every path carries signal."""
    torch.manual_seed(3)
    spec = AvatarSpec(block=block, uv_encoding_size=64)
    model = PixelCodecAvatar(
        spec, toy_prior(), ModelOptions(encoding_amplitude=1.0, texture_contrast=0.0)
    )
    with torch.no_grad():
        for decoder in (model.geometry, model.expression):
            for name, values in decoder.named_tensors().items():
                if "bias" in name:
                    values.normal_(std=0.05)
            list(decoder.named_tensors().values())[-2].mul_(100)
    return model


def decoded(model: PixelCodecAvatar) -> tuple[torch.Tensor, ...]:
    torch.manual_seed(4)
    latent = torch.randn(1, 4, 8, 8)
    view = torch.nn.functional.normalize(torch.randn(1, 3))
    with torch.no_grad():
        position = model.decode_mesh(latent).position_map_m
        assert position is not None
        return latent, view, position, model.appearance(latent, view)


@pytest.mark.parametrize("block", BLOCKS)
def test_torch_numpy_and_onnx_decode_the_same_maps(block: str) -> None:
    model = trained_looking_model(block)
    latent, view, position, expression = decoded(model)

    avatar, z, direction = exported(model), latent.permute(0, 2, 3, 1).numpy(), view.numpy()
    onnx_position, onnx_expression = run(decoder_graph(avatar), latent=z, view_direction=direction)
    by_layers = decode_position_map(avatar, z[0]), decode_expression_map(avatar, z[0], direction[0])

    assert np.abs(onnx_position - by_layers[0]).max() <= MAP_ONNX_M
    assert np.abs(onnx_expression - by_layers[1]).max() <= EXPRESSION_ONNX
    offset = position[0].permute(1, 2, 0).numpy() - model.position_mean.permute(1, 2, 0).numpy()
    assert np.abs(offset).max() > 100 * MAP_TORCH_M, "the test would not notice a dead decoder"
    assert np.abs(onnx_position - position[0].permute(1, 2, 0).numpy()).max() <= MAP_TORCH_M
    assert np.abs(onnx_expression - expression[0].permute(1, 2, 0).numpy()).max() <= EXPRESSION_ONNX


@pytest.mark.parametrize("level", [64, 128])
@pytest.mark.parametrize("block", BLOCKS)
def test_torch_numpy_and_onnx_leave_by_the_same_exit(block: str, level: int) -> None:
    avatar = with_toy_levels(exported(trained_looking_model(block)))
    torch.manual_seed(4)
    faces = FaceSet(torch.randn(1, 4, 8, 8), torch.nn.functional.normalize(torch.randn(1, 3)))
    name = f"level.{level}.expression"
    weight, bias = (torch.from_numpy(avatar.tensors[f"{name}.{n}"]) for n in ("weight", "bias"))
    local = None
    if level == 64:
        local = torch.from_numpy(avatar.tensors[local_name(64)])
        local = local.unflatten(2, (EXPRESSION_CHANNELS, -1))
    ((seen, _),) = FrozenDecoder(avatar).run(faces, level)
    codes = MapExit(weight, bias, local)(seen)[0].permute(1, 2, 0).numpy()
    latent, view = faces.latents.permute(0, 2, 3, 1).numpy(), faces.views.numpy()
    told = decode_expression_map(avatar, latent[0], view[0], level)
    inputs = {"latent": latent, "view_direction": view}
    position, expression = run(decoder_graph(avatar, level=level), **inputs)
    (alone,) = run(decoder_graph(avatar, level=level, positions=False), **inputs)
    assert np.ptp(expression) > 100 * EXPRESSION_ONNX
    assert np.abs(expression - codes).max() <= EXPRESSION_ONNX
    assert np.abs(expression - told).max() <= EXPRESSION_ONNX
    assert np.abs(alone - expression).max() <= EXPRESSION_ONNX
    by_layers = decode_position_map(avatar, latent[0], level)
    assert np.abs(position - by_layers).max() <= MAP_ONNX_M


@functools.cache
def toy(block: str) -> Avatar:
    spec = AvatarSpec(block=block, uv_encoding_size=16, axis_encoding_size=20)
    return make_toy_avatar(spec=spec, grid=4)


def run(model: bytes, **inputs: Array) -> list[Array]:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    feeds = {name: array.astype(np.float32) for name, array in inputs.items()}
    outputs: list[Array] = session.run(None, feeds)
    return outputs


def test_a_level_that_the_avatar_lacks_has_no_graph() -> None:
    with pytest.raises(ValueError, match="level is 64; this avatar has 256"):
        decoder_graph(toy("G"), level=64)


@pytest.mark.parametrize("block", BLOCKS)
def test_the_graph_is_valid_onnx_of_an_old_operator_set(block: str) -> None:
    model = onnx.load_from_string(decoder_graph(toy(block)))
    onnx.checker.check_model(model, full_check=True)
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", 17)]
