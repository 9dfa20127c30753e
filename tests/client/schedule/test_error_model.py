"""A measured table becomes one in which more is never worse and nearer never less."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pica_client.schedule.error_model import ErrorModel
from pica_core.avatar.levels import LevelErrors, default_errors

pytestmark = pytest.mark.unit

HEIGHTS = np.array([16, 64, 256, 1024], np.float32)


def table(mse: np.ndarray) -> LevelErrors:
    return LevelErrors(
        levels=(64, 128, 256),
        head_px=HEIGHTS,
        mse=mse,
        view_mse_per_rad2=10.0,
        latent_mse_per_unit2=20.0,
    )


def test_at_its_own_heights_a_well_behaved_table_is_told_as_it_is() -> None:
    measured = default_errors((64, 128, 256))
    errors = ErrorModel(measured)
    for height in (64.0, 512.0):
        maps, meshes, own = errors.extra(height)
        assert own == pytest.approx(measured.at(256, height), rel=1e-5)
        for level, map_mse, mesh_mse in zip(measured.levels, maps, meshes, strict=True):
            on_mesh = measured.at(level, height, full_maps=True)
            assert own + mesh_mse == pytest.approx(on_mesh, rel=1e-4)
            whole = measured.at(level, height)
            assert own + mesh_mse + map_mse == pytest.approx(whole, rel=1e-4)


def test_beyond_the_table_its_ends_hold() -> None:
    errors = ErrorModel(default_errors((64, 128, 256)))
    assert errors.extra(0.0) == errors.extra(1.0) == errors.extra(16.0)
    assert errors.extra(1e9) == errors.extra(2048.0)


def test_an_avatar_of_one_level_has_nothing_to_gain_from_another() -> None:
    maps, meshes, _ = ErrorModel(default_errors((256,))).extra(300.0)
    assert maps == meshes == [0.0]


@given(
    arrays.arrays(np.float32, (3, 2, 4), elements=st.floats(0, 1000, width=32)),
    st.floats(1, 5000),
    st.floats(1, 4),
)
def test_whatever_was_measured_more_is_not_worse_and_nearer_not_less(
    mse: np.ndarray, head_px: float, factor: float
) -> None:
    errors = ErrorModel(table(mse))
    far, near = errors.extra(head_px), errors.extra(head_px * factor)
    for kind in (0, 1):
        for extra in (far[kind], near[kind]):
            assert all(coarse >= fine for coarse, fine in itertools.pairwise(extra))
            assert extra[-1] == 0
        for coarse, fine in ((0, 1), (1, 2)):
            steps = near[kind][coarse] - near[kind][fine], far[kind][coarse] - far[kind][fine]
            assert steps[0] >= steps[1] - 1e-3
