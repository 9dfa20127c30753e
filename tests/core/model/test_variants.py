"""The rows of the paper's tables: sizes, costs, and one answer from torch, numpy and ONNX."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.tolerances import PIXEL_FLOAT32
from helpers.toy import PAPER_SPEC
from helpers.trainable import exported, toy_prior
from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.avatar.spec import FULL, VARIANTS, AvatarSpec
from pica_core.model.avatar import PixelCodecAvatar, make_model
from pica_core.model.interface import (
    AvatarModel,
    ExpressionEncoder,
    FacePrior,
    ModelOptions,
    Surface,
    flat_latent,
)
from pica_core.reference import decode_pixels, encode_surface

pytestmark = pytest.mark.train

SMALL = AvatarSpec(uv_encoding_size=32, axis_encoding_size=200)
PRIOR = toy_prior()
OPTIONS = ModelOptions(encoding_amplitude=1.0, texture_contrast=0.0, texture_size=64)
NUM_PIXELS = 500
DECODED = [name for name, row in VARIANTS.items() if row.geometry == "decoder"]
"""Rows with a decoder; those with bases have tests of their own (`graphs/test_bases_judges`)."""


def small_model(variant: str) -> AvatarModel:
    torch.manual_seed(2)
    return make_model(variant, SMALL, PRIOR, OPTIONS)


def some_pixels() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    codes = rng.standard_normal((NUM_PIXELS, 4))
    xyz_m = rng.uniform(-0.1, 0.1, (NUM_PIXELS, 3))
    uv = rng.uniform(0, 1, (NUM_PIXELS, 2)).astype(np.float32).astype(np.float64)
    return codes, xyz_m, uv


def test_each_row_is_full_with_one_part_replaced() -> None:
    for name, row in VARIANTS.items():
        changed = [
            f
            for f in ("network", "encoding", "topology", "geometry")
            if getattr(row, f) != getattr(FULL, f)
        ]
        # A baseline without the tracker's mesh would be another paper's.
        assert len(changed) == (0 if name == "full" else 2 if name == "baseline" else 1)


@pytest.mark.parametrize("variant", DECODED)
def test_the_cost_counts_the_weights_that_a_receiver_runs(variant: str) -> None:
    model = small_model(variant)
    others = {*model.encoder.parameters(), *model.expression_encoder.parameters()}

    trained = sum(p.numel() for p in model.parameters() if p not in others)

    assert model.cost.parameters == trained


def test_the_papers_model_and_its_baseline_have_their_published_sizes() -> None:
    prior, paper = replace_tracked(7306), replace(OPTIONS, texture_size=1024)
    full = make_model("full", PAPER_SPEC, toy_prior(), paper).cost
    baseline = make_model("baseline", PAPER_SPEC, prior, paper).cost

    assert abs(full.parameters - 5_470_000) < 0.005 * 5_470_000
    assert 17_000_000 < baseline.parameters < 19_080_000
    assert full.per_pixel_multiply_adds == 308
    assert full.per_object_multiply_adds == pytest.approx(114e6, rel=0.01)
    assert baseline.per_object_multiply_adds == pytest.approx(762e6, rel=0.01)


def replace_tracked(count: int) -> FacePrior:
    prior = toy_prior()
    uv = np.random.default_rng(0).uniform(0, 1, (count, 2)).astype(np.float32)
    return replace(prior, tracked_uv=uv, tracked_mean_m=np.zeros((count, 3), np.float32))


@pytest.mark.parametrize("variant", [v for v in DECODED if v != "baseline"])
def test_torch_colours_pixels_as_the_reference_does(variant: str) -> None:
    model = small_model(variant)
    assert isinstance(model, PixelCodecAvatar)
    avatar = exported(model)
    codes, xyz_m, uv = some_pixels()
    reference = decode_pixels(avatar.spec, avatar.tensors, codes, xyz_m, uv, np.float64)

    inputs = [torch.from_numpy(values).to(torch.float32) for values in (codes, xyz_m, uv)]
    with torch.no_grad():
        by_torch = model.pixel_decoder(*inputs).numpy()

    assert np.ptp(reference) > 0.2, "the test would not notice a constant colour"
    assert np.abs(by_torch - reference).max() <= PIXEL_FLOAT32


def test_sinusoids_are_forty_and_run_through_whole_turns() -> None:
    spec = replace(SMALL, encoding="sinusoids")
    code = encode_surface(spec, {}, np.array([[0.25, 0.5], [0.0, 0.0]]), np.float64)

    assert code.shape == (2, 40)
    np.testing.assert_allclose(code[0, :8], [1, 0, 0, -1, 0, 0, -1, 1], atol=1e-12)
    np.testing.assert_allclose(code[1], np.tile([0, 0, 1, 1], 10), atol=1e-12)


@pytest.mark.parametrize("variant", DECODED)
def test_the_image_reaches_every_weight_that_makes_it(variant: str) -> None:
    model = small_model(variant)
    latent = torch.randn(2, 4, 8, 8)
    mesh = model.decode_mesh(latent)
    surface = Surface(torch.rand(2, 2, 2), mesh.vertices_m[:, 7:9])
    maps = model.appearance(latent, torch.nn.functional.normalize(torch.randn(2, 3)))

    colours = model.shade(maps, surface)
    (colours.sum() + mesh.tracked_m.square().sum()).backward()  # type: ignore[no-untyped-call]

    encoder = {*model.encoder.parameters(), *model.expression_encoder.parameters()}
    silent = [name for name, p in model.named_parameters() if p not in encoder and p.grad is None]
    assert silent == []
    assert mesh.vertices_m.shape[1] == {"dense": 256, "tracked": 81}[model.topology]


def test_a_live_encoder_begins_as_the_regression_that_it_is_given() -> None:
    encoder, arkit = ExpressionEncoder(), torch.rand(40, 52)
    lifted = ExpressionEncoder.lifted(arkit)
    matrix, offset = torch.randn(256, lifted.shape[1]), torch.randn(256)

    encoder.start_from(matrix, offset)

    found = flat_latent(encoder(arkit))
    torch.testing.assert_close(found, lifted @ matrix.T + offset, atol=1e-3, rtol=1e-4)
    assert (lifted[:, :52] == arkit).all()
    bent = ExpressionEncoder.lifted(
        torch.linspace(0, 1, 11)[:, None] * torch.eye(52)[ARKIT_INDEX["eyeBlinkLeft"]]
    )[:, 52:]
    assert (bent.diff(n=2, dim=0).abs().amax(0) > 0.05).sum() >= 4  # a blink alone bends
