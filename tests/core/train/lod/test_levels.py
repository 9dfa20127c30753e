"""Levels: near to the full model, without cracks, and nothing else changed."""

import numpy as np
import pytest
import torch

from helpers.toy import grid_faces, make_toy_avatar, with_bases
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import MAP_SIZE, AvatarSpec
from pica_core.model.networks import sample_map
from pica_core.train.lod import levels
from pica_core.train.lod.exits import FaceSet, FrozenDecoder, fit_convolution, fit_local, fit_map
from pica_core.train.lod.levels import seen_vertices
from pica_core.train.lod.simplify import Simplifier

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]


SMALL = AvatarSpec(uv_encoding_size=16, axis_encoding_size=20)
TOY = with_bases(make_toy_avatar(grid=20, spec=SMALL))
QUICK = {
    "NUM_FACES": 64,
    "ROUNDS": 1,
    "POINTS": 500,
    "BIAS_POINTS": 10_000,
    "MESH_RATIOS": (0.3, 0.6),
}


@pytest.fixture(scope="module")
def levelled() -> Avatar:
    with pytest.MonkeyPatch.context() as patch:
        for name, value in QUICK.items():
            patch.setattr(levels, name, value)
        return levels.add_levels(TOY)


# Exits


def test_an_avatar_gets_every_level_and_keeps_all_else(levelled: Avatar) -> None:
    assert levelled.levels == (64, 128, 256)
    for name, array in TOY.tensors.items():
        assert levelled.tensors[name] is array


# Maps that are read at points


def test_blocks_learn_what_a_convolution_leaves_and_keep_the_mean_face() -> None:
    decoder, generator = FrozenDecoder(TOY), torch.Generator().manual_seed(0)
    latents = torch.randn(64, 4, 8, 8, generator=generator)
    faces = FaceSet(latents, torch.nn.functional.normalize(torch.ones(64, 3)))
    size = MAP_SIZE
    trunk, full = (torch.cat(maps) for maps in zip(*decoder.run(faces, 64), strict=True))
    points = torch.rand(4000, 2, generator=generator)
    metric = torch.eye(4).expand(len(points), 4, 4)
    shared = fit_convolution(decoder, faces, 64, points, metric, points, torch.zeros(4, size, size))

    own = fit_local(decoder, faces, 64, shared)

    assert own.local is not None
    assert own.local.shape[:3] == (32, 32, 4)
    mean = trunk.mean(0, keepdim=True)
    assert (own(mean) - shared(mean)).abs().max() < 1e-4
    wanted = torch.nn.functional.adaptive_avg_pool2d(full - full.mean(0), 64)
    left = [(made(trunk) - made(mean) - wanted).square().mean() for made in (own, shared)]
    assert left[0] < 0.9 * left[1]


def test_a_fitted_map_gives_its_values_back_at_its_points() -> None:
    across = (2 * torch.arange(7) + 1.8) / 16
    points = torch.cartesian_prod(across, across)
    values = torch.randn(49, 2, generator=torch.Generator().manual_seed(0))
    found = fit_map(points, values, torch.zeros(2, 16, 16))
    assert (sample_map(found[None], points)[0] - values).abs().max() < 0.02


# Meshes


def test_a_flat_sheet_needs_few_triangles_and_keeps_its_corners() -> None:
    u, v = np.meshgrid(np.linspace(0, 1, 20), np.linspace(0, 1, 20))
    uv = np.stack([u, v], -1).reshape(-1, 2)
    flat = np.concatenate([uv, np.zeros((400, 1))], axis=1)
    mesh = Simplifier(flat[None], uv, grid_faces(20, 20))
    mesh.reduce(40)
    faces = mesh.faces()
    assert len(faces) <= 40
    assert {0, 19, 380, 399} <= set(faces.reshape(-1).tolist())


def test_a_crease_of_another_expression_is_kept() -> None:
    u, v = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21))
    uv = np.stack([u, v], -1).reshape(-1, 2)
    flat = np.concatenate([uv, np.zeros((441, 1))], axis=1)
    folded = flat.copy()
    folded[:, 2] = 0.3 * np.abs(uv[:, 0] - 0.5)
    mesh = Simplifier(np.stack([flat, folded]), uv, grid_faces(21, 21))
    mesh.reduce(60)
    used = uv[np.unique(mesh.faces())]
    assert (np.abs(used[:, 0] - 0.5) < 1e-6).sum() >= 2


# What is seen


def test_what_another_surface_hides_from_every_view_is_not_seen() -> None:
    across = np.linspace(-1, 1, 9)
    flat = np.stack([*np.meshgrid(across, across), np.zeros((9, 9))], -1).reshape(-1, 3)
    shape = np.concatenate([0.08 * flat, 0.02 * flat - [0, 0, 0.01]])[None]
    sheet = grid_faces(9, 9)
    seen = [
        seen_vertices(shape, np.concatenate([way, way + 81])) for way in (sheet, sheet[:, ::-1])
    ]
    assert [side[81:].any() for side in seen] == [False, False]
    assert sorted(side[:81].all() for side in seen) == [False, True], "one side faces the views"
