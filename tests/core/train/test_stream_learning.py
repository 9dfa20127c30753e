"""Learning a stream's profile: it is valid, repeatable, worth its bytes, or refused with the
reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.stream_toy import (
    NUM_COMPONENTS,
    Publisher,
    toy_faces,
    toy_metric,
    toy_pose,
    toy_profile,
)
from pica_core.codec.profile import StreamProfile
from pica_core.errors import ProfileError
from pica_core.train.stream_learning import RenderMetric, learn_profile

pytestmark = pytest.mark.unit

FACES = toy_faces(1, 150).reshape(-1, 256)


def learn(codes: np.ndarray, metric: RenderMetric | None = None) -> StreamProfile:
    return learn_profile(codes, metric or toy_metric(), num_components=4, turn_sweeps=1)


def num_bytes(profile: StreamProfile, **options: int) -> int:
    publisher = Publisher(profile, **options)
    publisher.show_all(toy_faces(31, 600, 0.3), 0.1 * toy_pose(31, 600))  # a quiet talker
    return sum(len(frame.payload) for frame in publisher.sent)


def test_learning_again_gives_the_same_profile() -> None:
    first, second = (learn(FACES).to_tensors() for _ in range(2))
    for name, array in first.items():
        np.testing.assert_array_equal(second[name], array)


def test_one_unit_of_a_coefficient_is_a_64th_of_a_root_of_rendered_mse() -> None:
    profile, metric = toy_profile(), toy_metric()
    neutral = profile.synthesise(np.zeros(NUM_COMPONENTS, np.int64))
    for component in range(NUM_COMPONENTS):
        coefficients = np.zeros(NUM_COMPONENTS, np.int64)
        coefficients[component] = 640
        along = (profile.synthesise(coefficients) - neutral).astype(np.float64)
        along = along @ metric.directions.T
        assert along @ metric.gram @ along == pytest.approx(10**2, rel=0.01)


def test_the_choice_of_tables_is_worth_having() -> None:
    profile = toy_profile()
    flat = replace(profile, table_index=np.full_like(profile.table_index, 10))
    assert num_bytes(profile) < 0.75 * num_bytes(flat)


def test_faces_that_never_change_give_a_profile_all_the_same() -> None:
    profile = learn(np.ones((120, 256)))
    np.testing.assert_array_equal(
        profile.synthesise(np.zeros(profile.num_components, np.int64)), np.ones(256)
    )


@pytest.mark.parametrize(
    ("scale", "message"),
    [
        (0.0, "does not change with the latent"),
        (np.nan, "not finite"),
        (1e-14, r"stream\.synthesis reaches"),
        (1e14, r"stream\.analysis reaches"),
    ],
)
def test_a_metric_that_no_profile_can_hold_is_refused(scale: float, message: str) -> None:
    metric = RenderMetric(toy_metric().directions, toy_metric().gram * scale)
    with pytest.raises(ProfileError, match=message):
        learn(FACES, metric)
