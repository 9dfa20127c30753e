"""A measured table becomes one in which more is never worse and nearer never less."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pica_client.error_model import ErrorModel
from pica_core.levels import LevelErrors, default_errors

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
        *over_full, half, full = errors.extra(height)
        assert full == pytest.approx(measured.at(256, 1, height), rel=1e-5)
        for level, extra in zip(measured.levels, over_full, strict=True):
            assert full + extra == pytest.approx(measured.at(level, 1, height), rel=1e-4)
        assert half >= measured.at(128, 2, height) - measured.at(128, 1, height) - 1e-4


def test_beyond_the_table_its_ends_hold() -> None:
    errors = ErrorModel(default_errors((64, 128, 256)))
    assert errors.extra(0.0) == errors.extra(1.0) == errors.extra(16.0)
    assert errors.extra(1e9) == errors.extra(2048.0)


def test_an_avatar_of_one_level_has_nothing_to_gain_from_another() -> None:
    *over_full, _, _ = ErrorModel(default_errors((256,))).extra(300.0)
    assert over_full == [0.0]


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
    for extra in (far, near):
        assert all(coarse >= fine for coarse, fine in itertools.pairwise(extra[:3]))
        assert extra[2] == 0
        assert extra[3] >= 0
    for coarse, fine in ((0, 1), (1, 2)):
        assert near[coarse] - near[fine] >= far[coarse] - far[fine] - 1e-3
    assert near[3] >= far[3] - 1e-3
