"""Learning a stream's profile: it is valid, repeatable, worth its bytes, or refused with the
reason."""

from __future__ import annotations

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
from pica_core.codec.latent_stream import StreamConfig
from pica_core.codec.profile import NUM_LENGTHS, NUM_POSE, NUM_SYMBOLS, StreamProfile
from pica_core.errors import ProfileError, ShapeError
from pica_core.train.stream_learning import RenderMetric, learn_profile

pytestmark = pytest.mark.unit

FACES = toy_faces(1, 150)


def learn(
    sequences: list[np.ndarray], metric: RenderMetric | None = None, num_components: int = 4
) -> StreamProfile:
    return learn_profile(
        sequences,
        metric or toy_metric(),
        num_components=num_components,
        num_tables=3,
        turn_sweeps=1,
    )


def num_bytes(profile: StreamProfile, **options: int) -> int:
    publisher = Publisher(StreamConfig(**options), profile=profile)
    publisher.show_all(toy_faces(31, 600, 0.3), 0.1 * toy_pose(31, 600))  # a quiet talker
    return sum(len(frame.payload) for frame in publisher.sent)


def test_learning_again_gives_the_same_profile() -> None:
    hashes = {learn([FACES]).hash for _ in range(2)}
    assert len(hashes) == 1


def test_one_unit_of_a_coefficient_is_a_64th_of_a_root_of_rendered_mse() -> None:
    profile, metric = toy_profile(), toy_metric()
    neutral = profile.synthesise(np.zeros(NUM_COMPONENTS, np.int64))
    for component in range(NUM_COMPONENTS):
        coefficients = np.zeros(NUM_COMPONENTS, np.int64)
        coefficients[component] = 640
        along = (profile.synthesise(coefficients) - neutral).astype(np.float64)
        along = along @ metric.directions.T
        assert along @ metric.gram @ along == pytest.approx(10**2, rel=0.01)


def test_learned_tables_are_worth_having() -> None:
    tensors = toy_profile().to_tensors()
    tables = np.full((1, NUM_SYMBOLS), 2**14 // NUM_SYMBOLS, np.uint16)
    tables[0, 0] += 2**14 - tables.sum(dtype=int)
    lengths = np.full((NUM_POSE, NUM_LENGTHS), 2**14 // NUM_LENGTHS, np.uint16)
    lengths[:, 0] += np.uint16(2**14 - lengths[0].sum(dtype=int))
    flat = StreamProfile.from_tensors(
        {
            **tensors,
            "stream.tables": tables,
            "stream.pose_tables": lengths,
            "stream.table_index": np.zeros_like(tensors["stream.table_index"]),
        }
    )
    assert flat is not None
    assert num_bytes(toy_profile()) < 0.75 * num_bytes(flat)


def test_faces_that_never_change_give_a_profile_all_the_same() -> None:
    profile = learn([np.ones((120, 256))])
    np.testing.assert_array_equal(
        profile.synthesise(np.zeros(profile.num_components, np.int64)), np.ones(256)
    )


@pytest.mark.parametrize(
    "sequences",
    [
        [],
        [FACES[:99]],
        [FACES, FACES[:0]],
        [FACES, FACES[:4]],
        [np.zeros((150, 8, 8, 3))],
        [np.zeros((150, 255))],
        [np.zeros(256)],
    ],
    ids=["none", "too few", "empty", "too short", "other channels", "other length", "one face"],
)
def test_sequences_of_another_shape_are_refused(sequences: list[np.ndarray]) -> None:
    with pytest.raises(ShapeError, match="are needed"):
        learn(sequences)


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
        learn([FACES], metric)
