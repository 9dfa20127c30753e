"""The torch model against the paper's numbers."""

import pytest
import torch
from torch import nn

from helpers.trainable import toy_prior
from pica_core.avatar.spec import AvatarSpec
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.model.interface import ModelOptions, Surface
from pica_core.model.networks import ENCODERS, sample_map
from pica_core.model.pixel_decoder import PixelDecoder

pytestmark = pytest.mark.train

SMALL = AvatarSpec(uv_encoding_size=32, axis_encoding_size=64)
UNIFORM = ModelOptions(encoding_amplitude=1.0, texture_contrast=0.0)


def count(module: nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def small_avatar() -> PixelCodecAvatar:
    torch.manual_seed(0)
    return PixelCodecAvatar(SMALL, toy_prior(scale_m=0.01), UNIFORM)


def test_the_papers_encoder_gives_mean_and_variance_of_an_8_by_8_by_4_latent() -> None:
    encoder = ENCODERS["paper"]()
    assert (
        count(encoder)
        == 512 * 49
        + 256 * (512 * 16 + 1)
        + 256 * 4
        + sum(b * (a * 16 + 1) for a, b in [(512, 128), (128, 64), (64, 32), (32, 16), (16, 8)])
        + 2 * 4 * 9
    )

    with torch.no_grad():  # a quarter of the size in each direction shows the same structure
        mean, log_variance = encoder(torch.zeros(1, 3, 256, 256), torch.zeros(1, 3, 64, 64))

    assert mean.shape == log_variance.shape == (1, 4, 2, 2)


def test_the_colour_loss_reaches_uv_and_not_xyz() -> None:
    xyz, uv = (torch.rand(1, 5, width, requires_grad=True) for width in (3, 2))
    surface = Surface(uv, xyz)

    small_avatar().shade(torch.zeros(1, 4, 256, 256), surface).sum().backward()

    assert xyz.grad is None
    assert uv.grad is not None


def test_the_drawn_and_the_tracked_mesh_are_samples_of_one_map() -> None:
    prior = toy_prior()
    latent = torch.randn(2, 4, 8, 8)
    torch.manual_seed(0)
    dense = PixelCodecAvatar(SMALL, prior, UNIFORM)
    torch.manual_seed(0)
    coarse = PixelCodecAvatar(SMALL, prior, UNIFORM, topology="tracked")

    with torch.no_grad():
        fine, rough = dense.decode_mesh(latent), coarse.decode_mesh(latent)

    assert fine.vertices_m.shape == (2, 16 * 16, 3)
    assert fine.tracked_m.shape == rough.vertices_m.shape == (2, 9 * 9, 3)
    assert torch.equal(fine.tracked_m, rough.vertices_m)
    assert torch.equal(fine.vertices_m, dense.vertices(latent))


def test_every_weight_but_the_expression_encoders_is_in_one_group() -> None:
    avatar = small_avatar()

    grouped = [p for group in avatar.parameter_groups().values() for p in group]

    wanted = {id(p) for p in avatar.parameters()} - {
        id(p) for p in avatar.expression_encoder.parameters()
    }
    assert {id(p) for p in grouped} == wanted
    assert len(grouped) == len(wanted)


def test_the_pixel_decoder_starts_near_the_mean_texture_whatever_the_seed() -> None:
    torch.manual_seed(4)
    uv = torch.rand(500, 2)
    xyz_m = 0.1 * torch.cat([uv, torch.zeros(500, 1)], 1)
    texture = torch.nn.functional.interpolate(torch.rand(1, 3, 4, 4), 64, mode="bilinear")[0]
    wanted = sample_map(texture[None], uv)[0]
    for seed in range(6):
        torch.manual_seed(seed)
        decoder = PixelDecoder(SMALL)
        left = []
        for _ in range(2):
            with torch.no_grad():
                shown = decoder(torch.zeros(500, 4), xyz_m, uv)
            left.append(float((shown - wanted).square().mean() / wanted.var(0).mean()))
            decoder.start_from(texture, 0.3, xyz_m, uv)
        assert left[1] < 0.75 < 1 < left[0]
