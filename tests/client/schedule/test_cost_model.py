"""What things cost is learned: from nothing, through noise, past spikes, and never below zero."""

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.schedule.cost_model import CostModel, DrawCost, expected_decode_s

pytestmark = pytest.mark.unit

TRUTH = DrawCost(frame_s=2e-3, triangle_s=150e-9, pixel_s=20e-9)


def draw_s(triangles: float, pixels: float) -> float:
    return TRUTH.frame_s + TRUTH.triangle_s * triangles + TRUTH.pixel_s * pixels


def learn(costs: CostModel, slower: float = 1.0) -> None:
    """See 200 frames of a scene that changes on a machine that is so many times slower."""
    rng = random.Random(1)
    for _ in range(200):
        triangles, pixels = rng.uniform(0, 60_000), rng.uniform(0, 300_000)
        costs.observe_draw(
            triangles, pixels, slower * draw_s(triangles, pixels) * rng.gauss(1, 0.05)
        )


def test_before_anything_is_measured_the_expected_holds() -> None:
    costs = CostModel()
    assert costs.draw == DrawCost()
    levels = [costs.decode_s("", level, "both") for level in (64, 128, 256, 512)]
    assert levels == sorted(levels)
    assert costs.decode_s("", 128, "expression") < costs.decode_s("", 128, "both")


def test_a_decode_costs_the_median_of_what_was_measured_lately() -> None:
    costs = CostModel()
    for seconds in (0.002, 0.0021, 0.0019, 0.002, 0.5):
        costs.observe_decode("", 256, "both", seconds)
    assert costs.decode_s("", 256, "both") == 0.002


@pytest.mark.parametrize("model", ["", "other"])
def test_what_was_never_decoded_is_expected_to_be_as_slow_as_the_machine(model: str) -> None:
    costs = CostModel()
    costs.observe_decode("", 256, "both", 3 * expected_decode_s(256, "both"))
    assert costs.decode_s(model, 64, "both") == pytest.approx(3 * expected_decode_s(64, "both"))


def test_the_parts_of_drawing_are_told_apart_by_scenes_that_change() -> None:
    costs = CostModel()
    learn(costs)
    assert costs.draw.frame_s == pytest.approx(TRUTH.frame_s, rel=0.25)
    assert costs.draw.triangle_s == pytest.approx(TRUTH.triangle_s, rel=0.15)
    assert costs.draw.pixel_s == pytest.approx(TRUTH.pixel_s, rel=0.15)


def test_a_scene_that_never_changes_is_still_foretold() -> None:
    costs = CostModel()
    for _ in range(100):
        costs.observe_draw(30_000, 100_000, 0.040)
    assert costs.draw.seconds(30_000, 100_000) == pytest.approx(0.040, rel=0.03)
    assert min(costs.draw.frame_s, costs.draw.triangle_s, costs.draw.pixel_s) >= 0


@pytest.mark.parametrize("spike", [1.0, 1e-6])
def test_a_spike_moves_nothing(spike: float) -> None:
    costs = CostModel()
    learn(costs)
    for _ in range(9):
        costs.observe_decode("", 128, "both", 0.001)
    before = (costs.draw.seconds(20_000, 100_000), costs.decode_s("", 128, "both"))
    costs.observe_draw(20_000, 100_000, spike)
    costs.observe_decode("", 128, "both", spike)
    after = (costs.draw.seconds(20_000, 100_000), costs.decode_s("", 128, "both"))
    assert after == pytest.approx(before, rel=0.05)


def test_a_change_that_lasts_is_learned_within_seconds() -> None:
    costs = CostModel()
    learn(costs)
    learn(costs, slower=6)
    assert costs.draw.seconds(30_000, 150_000) == pytest.approx(
        6 * draw_s(30_000, 150_000), rel=0.1
    )


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf"), 3600.0])
def test_nonsense_is_no_measurement(seconds: float) -> None:
    costs = CostModel()
    before = costs.draw, costs.decode_s("", 64, "both")
    costs.observe_draw(1000, 1000, seconds)
    costs.observe_decode("", 64, "both", seconds)
    assert (costs.draw, costs.decode_s("", 64, "both")) == before


measured = st.tuples(st.floats(0, 1e6), st.floats(0, 1e7), st.floats(1e-6, 5.0))


@given(st.lists(measured, max_size=60))
def test_whatever_is_measured_no_cost_is_negative(frames: list[tuple[float, float, float]]) -> None:
    costs = CostModel()
    for triangles, pixels, seconds in frames:
        costs.observe_draw(triangles, pixels, seconds)
    draw = costs.draw
    assert min(draw.frame_s, draw.triangle_s, draw.pixel_s) >= 0
    assert 0 <= costs.draw.seconds(10_000, 10_000) < math.inf
