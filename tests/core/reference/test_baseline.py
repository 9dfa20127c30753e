"""The baseline: the published sizes, and the mesh that it borrows."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_core.avatar.spec import AvatarSpec
from pica_core.reference import BaselineSpec, baseline_like

pytestmark = [pytest.mark.unit, pytest.mark.slow]

TOY = make_toy_avatar(grid=12, spec=AvatarSpec(uv_encoding_size=16, axis_encoding_size=20))
SMALL = BaselineSpec(num_latent=6, num_vertices=5, channels=(4, 3))


def test_the_published_sizes_have_17_4_million_parameters_and_755_million_multiply_adds() -> None:
    spec = BaselineSpec()
    assert spec.texture_size == 1024
    assert spec.num_parameters == pytest.approx(17.4e6, rel=3e-3)
    fully_connected = 256 * 256 + 3 * 8 + 256 * 3 * 7306 + 264 * 4096
    assert spec.multiply_adds - fully_connected == pytest.approx(755e6, rel=1e-3)


def test_the_mesh_is_the_level_nearest_to_the_published_one() -> None:
    avatar = with_toy_levels(make_toy_avatar(grid=100, spec=TOY.spec))
    sizes = {level: len(avatar.level_faces(level)) for level in avatar.levels}
    assert min(sizes, key=lambda level: abs(sizes[level] - 10_936)) == 128
    baseline = baseline_like(avatar)
    assert len(baseline.faces) == sizes[128]
    kept = np.unique(avatar.level_faces(128))
    rest_m = baseline.tensors["mesh.bias"].reshape(-1, 3)
    np.testing.assert_array_equal(rest_m, avatar.mean_vertices_m[kept])
