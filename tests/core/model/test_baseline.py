"""The baseline in torch: it decodes what ONNX decodes, and begins as the mean face."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from helpers.toy import grid_faces
from helpers.trainable import toy_prior
from pica_client.decode.decoder import onnxruntime
from pica_core.avatar.spec import AvatarSpec
from pica_core.graphs.onnx_graph import baseline_graph
from pica_core.model.avatar import make_model
from pica_core.model.baseline import USUAL_INPUTS, Connected, DeepAppearanceModel
from pica_core.model.interface import ModelOptions, flat_latent
from pica_core.reference.baseline import (
    BaselineAvatar,
    baseline_channels,
)

pytestmark = pytest.mark.train

SPEC = AvatarSpec(uv_encoding_size=32, axis_encoding_size=64)
PRIOR = toy_prior()


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
    return BaselineAvatar(
        spec=model.baseline_spec,
        tensors={name: values.detach().numpy() for name, values in model.named_tensors().items()},
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
