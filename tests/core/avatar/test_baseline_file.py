"""A trained baseline: what torch decodes, its file decodes too; and what a file must be."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
import torch

from helpers.toy import grid_faces
from helpers.trainable import toy_prior
from pica_client.decode.onnx_runtime import onnxruntime
from pica_core.avatar.baseline import (
    KEY,
    BaselineAvatar,
    baseline_channels,
    load_baseline,
    save_baseline,
)
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.spec import AvatarSpec
from pica_core.errors import AvatarFileError
from pica_core.graphs.baseline_graph import baseline_graph
from pica_core.model.baseline import USUAL_INPUTS, Connected, DeepAppearanceModel
from pica_core.model.interface import flat_latent
from pica_core.model.options import ModelOptions
from pica_core.model.variants import make_model

pytestmark = pytest.mark.train

SPEC = AvatarSpec(map_size=32, hidden_channels=(6,), uv_encoding_size=32, axis_encoding_size=64)
PRIOR = toy_prior(map_size=32)


@pytest.fixture(scope="module")
def model() -> DeepAppearanceModel:
    """Weights as large as trained ones."""
    torch.manual_seed(1)
    made = make_model("baseline", SPEC, PRIOR, ModelOptions(texture_size=64))
    assert isinstance(made, DeepAppearanceModel)
    with torch.no_grad():
        for name, values in made.named_parameters():
            if name.endswith("bias"):
                values.normal_(std=0.05)
    return made.eval()


@pytest.fixture(scope="module")
def baseline(model: DeepAppearanceModel) -> BaselineAvatar:
    tensors = dict(model.named_tensors())
    for name, values in model.expression_encoder.layers.named_parameters():
        tensors[f"encoder.{name}"] = values
    return BaselineAvatar(
        spec=model.baseline_spec,
        tensors={name: values.detach().numpy() for name, values in tensors.items()},
        vertex_uv=PRIOR.tracked_uv,
        faces=grid_faces(9, 9),
        bounds_min_m=(-0.2, -0.2, -0.2),
        bounds_max_m=(0.2, 0.2, 0.2),
    )


def run(baseline: BaselineAvatar, latent: torch.Tensor, view: torch.Tensor) -> list[np.ndarray]:
    session = onnxruntime.InferenceSession(
        baseline_graph(baseline), providers=["CPUExecutionProvider"]
    )
    feed = {"latent": flat_latent(latent).numpy(), "view_direction": view.numpy()}
    found: list[np.ndarray] = session.run(["vertices", "texture"], feed)
    return found


def test_torch_and_onnx_decode_the_same_mesh_and_texture(
    model: DeepAppearanceModel, baseline: BaselineAvatar
) -> None:
    torch.manual_seed(2)
    latent = torch.randn(1, 4, 8, 8)
    view = torch.nn.functional.normalize(torch.randn(1, 3))
    with torch.no_grad():
        vertices_m = model.vertices(latent)[0].numpy()
        texture = model.appearance(latent, view)[0].permute(1, 2, 0).numpy()

    onnx_vertices_m, onnx_texture = run(baseline, latent, view)

    assert np.abs(vertices_m - PRIOR.tracked_mean_m).max() > 1e-4, "a dead decoder would pass"
    np.testing.assert_allclose(onnx_vertices_m, vertices_m, atol=2e-6)
    np.testing.assert_allclose(onnx_texture, texture, atol=2e-5)


def test_an_untrained_baseline_begins_as_the_mean_face_in_its_mean_colours() -> None:
    torch.manual_seed(3)
    fresh = make_model("baseline", SPEC, PRIOR, ModelOptions(texture_size=64))
    latent = torch.randn(2, 4, 8, 8)
    with torch.no_grad():
        vertices_m = fresh.vertices(latent).numpy()
        texture = fresh.appearance(latent, torch.tensor([[0.0, 0, 1]] * 2)).numpy()

    assert np.abs(vertices_m - PRIOR.tracked_mean_m).max() < PRIOR.position_scale_m
    mean = PRIOR.texture_mean.mean((0, 1))
    assert np.abs(texture.mean((0, 2, 3)) - mean).max() < 0.05
    assert np.abs(texture - mean[:, None, None]).mean() < 0.1


def test_a_baseline_comes_back_from_its_file(
    model: DeepAppearanceModel, baseline: BaselineAvatar, tmp_path: Path
) -> None:
    save_baseline(tmp_path / "b.safetensors", baseline)
    read = load_baseline(tmp_path / "b.safetensors")

    assert read.spec == baseline.spec
    assert np.array_equal(read.faces, baseline.faces)
    for name, values in baseline.tensors.items():
        np.testing.assert_allclose(read.tensors[name], values, rtol=1e-3, atol=1e-6)
    arkit = np.random.default_rng(0).uniform(0, 1, (3, 52)).astype(np.float32)
    with torch.no_grad():
        wanted = model.expression_encoder(torch.from_numpy(arkit)).permute(0, 2, 3, 1).numpy()
    np.testing.assert_allclose(ExpressionEncoder(read).encode(arkit), wanted, atol=2e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mesh.faces": np.array([[0, 1, 900]], np.int32)}, "vertices that are not there"),
        ({"mesh.faces": np.zeros((0, 3), np.int32)}, "0 faces"),
        ({"latent.bias": np.full(256, np.nan, np.float32)}, "not finite"),
        ({"latent.bias": np.zeros(3, np.float32)}, r"latent\.bias has shape \[3\]"),
        ({"surprise": np.zeros(3, np.float32)}, "'surprise' is unknown"),
        ({"encoder.0.weight": np.zeros((160, 51), np.float32)}, r"\[160, 51\]; \[160, 52\] is"),
    ],
)
def test_a_file_that_does_not_fit_its_manifest_is_refused(
    baseline: BaselineAvatar, tmp_path: Path, change: dict[str, np.ndarray], message: str
) -> None:
    path = tmp_path / "b.safetensors"
    save_baseline(path, baseline)
    data = path.read_bytes()
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    tensors = {**safetensors.numpy.load(data), **change}
    path.write_bytes(safetensors.numpy.save(tensors, header["__metadata__"]))

    with pytest.raises(AvatarFileError, match=message):
        load_baseline(path)


@pytest.mark.parametrize("data", [b"", b"not safetensors at all", b"\x00" * 64])
def test_any_other_file_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "b.safetensors"
    path.write_bytes(data)

    with pytest.raises(AvatarFileError, match="not a baseline file"):
        load_baseline(path)


def test_another_safetensors_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "b.safetensors"
    path.write_bytes(safetensors.numpy.save({"a": np.zeros(3, np.float32)}, {KEY: "[]"}))

    with pytest.raises(AvatarFileError, match="not a baseline file"):
        load_baseline(path)


def test_smaller_textures_leave_out_layers() -> None:
    assert baseline_channels(1024) == (256, 64, 64, 32, 32, 16, 16, 3)
    assert baseline_channels(512) == (256, 64, 64, 32, 32, 16, 3)
    with pytest.raises(ValueError, match="texture_size is 500"):
        baseline_channels(500)


def test_an_unknown_encoder_is_refused() -> None:
    with pytest.raises(ValueError, match="encoder is 'heavy'"):
        make_model("baseline", SPEC, PRIOR, ModelOptions(encoder="heavy"))


def test_a_layer_of_many_inputs_moves_no_further_in_a_step_than_a_usual_one() -> None:
    moved = []
    for inputs in (USUAL_INPUTS, 100 * USUAL_INPUTS):
        torch.manual_seed(0)
        layer, ones = Connected(inputs, 1), torch.ones(1, inputs)
        optimiser = torch.optim.Adam([layer.held], lr=1e-3)
        before = layer(ones)
        before.sum().backward()
        optimiser.step()
        moved.append(float((before - layer(ones)).detach()))

    assert moved[0] == pytest.approx(1e-3 * USUAL_INPUTS, rel=1e-3)
    assert moved[1] == pytest.approx(moved[0], rel=0.01)
