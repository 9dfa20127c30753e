"""The baseline in torch: it decodes what ONNX decodes, and begins as the mean face."""

import numpy as np
import pytest
import torch

from helpers.toy import make_toy_avatar, with_toy_levels
from helpers.trainable import toy_prior
from pica_core.avatar.spec import AvatarSpec
from pica_core.model.avatar import make_model
from pica_core.model.baseline import USUAL_INPUTS, Connected
from pica_core.model.interface import ModelOptions
from pica_core.reference import baseline_like

pytestmark = pytest.mark.train

SPEC = AvatarSpec(uv_encoding_size=32, axis_encoding_size=64)
PRIOR = toy_prior()


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


def test_the_mesh_to_compare_with_is_the_level_nearest_to_the_published_one() -> None:
    avatar = with_toy_levels(make_toy_avatar(grid=100, spec=SPEC))
    sizes = {level: len(avatar.level_faces(level)) for level in avatar.levels}
    assert min(sizes, key=lambda level: abs(sizes[level] - 10_936)) == 128
    baseline = baseline_like(avatar)
    assert len(baseline.faces) == sizes[128]
    kept = np.unique(avatar.level_faces(128))
    rest_m = baseline.tensors["mesh.bias"].reshape(-1, 3)
    np.testing.assert_array_equal(rest_m, avatar.mean_vertices_m[kept])
