"""What holds of the scheduler whatever the heads: budget, order, nearness, nearness to the best."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.scheduler_heads import (
    ERRORS,
    LEVELS,
    TRIANGLES,
    amount,
    gentle,
    plan,
    view,
)
from pica_client.schedule.cost_model import CostModel, ExpectedCosts
from pica_client.schedule.lod_knapsack import Climber, Rung, climb, hull
from pica_client.schedule.scheduler import HeadView, Plan

pytestmark = [pytest.mark.unit, pytest.mark.slow]


@st.composite
def head_views(draw: st.DrawFn, slot: str = "ada") -> HeadView:
    """Any head that can be."""
    is_visible = draw(st.booleans()) or draw(st.booleans())
    head_px = draw(st.floats(0.5, 2000))
    return view(
        slot,
        head_px=head_px if is_visible else 0.0,
        errors=draw(st.sampled_from([ERRORS, gentle()])),
        is_visible=is_visible,
        visible_px=head_px**2 * draw(st.floats(0.05, 0.7)) if is_visible else 0.0,
        hidden_ratio=draw(st.floats(0, 0.97)),
        held_level=draw(st.sampled_from([None, *LEVELS])),
        latent_change=draw(st.one_of(st.just(0.0), st.floats(0, 3))),
        view_turn_rad=draw(st.one_of(st.just(0.0), st.floats(0, 1))),
        age_s=draw(st.floats(0, 1)),
        speed_px_s=draw(st.one_of(st.just(0.0), st.floats(0, 5000))),
        is_stale=draw(st.booleans()),
    )


@st.composite
def scenes(draw: st.DrawFn) -> list[HeadView]:
    return [draw(head_views(slot=f"h{i}")) for i in range(draw(st.integers(1, 6)))]


budgets = st.floats(0, 0.08)


@given(scenes(), budgets)
def test_the_budget_is_kept_whenever_the_floor_fits(heads: list[HeadView], budget_s: float) -> None:
    made = plan(*heads, budget_s=budget_s)
    assert made.floor_s <= made.cost_s
    assert made.cost_s <= max(budget_s, made.floor_s) + 1e-12
    frame_s = ExpectedCosts().draw.frame_s if any(h.is_visible for h in heads) else 0.0
    shares = sum(choice.cost_s for choice in made.choices.values())
    assert shares + frame_s == pytest.approx(made.cost_s)


@given(scenes(), budgets, st.randoms(use_true_random=False))
def test_the_plan_does_not_depend_on_the_order_of_heads(
    heads: list[HeadView], budget_s: float, random: object
) -> None:
    shuffled = list(heads)
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    one, other = plan(*heads, budget_s=budget_s), plan(*shuffled, budget_s=budget_s)
    assert dict(one.choices) == dict(other.choices)
    assert (one.cost_s, one.error) == (other.cost_s, other.error)


@given(scenes(), budgets, budgets)
def test_more_budget_never_means_more_error(
    heads: list[HeadView], budget_s: float, more_s: float
) -> None:
    small, large = plan(*heads, budget_s=budget_s), plan(*heads, budget_s=budget_s + more_s)
    same_weights = [replace(head, is_stale=False) for head in heads]
    if any(head.is_stale for head in heads):  # a faded head's error counts less than it is
        small = plan(*same_weights, budget_s=budget_s)
        large = plan(*same_weights, budget_s=budget_s + more_s)
    assert large.error <= small.error * (1 + 1e-9) + 1e-9


@given(
    head_views(slot="far"),
    st.floats(1.001, 8),
    st.lists(head_views(slot="third"), max_size=1),
    budgets,
)
def test_nearer_never_gets_less_than_farther_at_equal_motion(
    far: HeadView, factor: float, others: list[HeadView], budget_s: float
) -> None:
    near = replace(
        far,
        slot="near",
        head_px=far.head_px * factor,
        visible_px=far.visible_px * factor**2,
        distance_m=far.distance_m / factor,
    )
    choices = plan(far, near, *others, budget_s=budget_s).choices
    near_choice, far_choice = choices["near"], choices["far"]
    if near_choice.is_limited:  # else it has all that can be seen of it, however that was cheapest
        assert amount(near_choice) >= amount(far_choice)
    layers = [-1 if c.wanted_layer is None else c.wanted_layer for c in (near_choice, far_choice)]
    assert layers[0] >= layers[1]


@given(scenes(), head_views(slot="gone"), budgets)
def test_an_unseen_head_costs_nothing_and_takes_nothing_from_the_others(
    heads: list[HeadView], gone: HeadView, budget_s: float
) -> None:
    gone = replace(gone, is_visible=False, visible_px=0.0, head_px=0.0)
    alone, together = plan(*heads, budget_s=budget_s), plan(*heads, gone, budget_s=budget_s)
    choice = together.choices["gone"]
    assert (choice.decode, choice.cost_s, choice.error) == ("none", 0.0, 0.0)
    assert {slot: together.choices[slot] for slot in alone.choices} == dict(alone.choices)


@given(scenes())
def test_the_work_of_a_plan_is_bounded_by_its_heads(heads: list[HeadView]) -> None:
    # Per head: three meshes for the maps that are there, with and without a new expression map, and
    # with new maps three for the full ones and one for each other level.
    assert plan(*heads).num_steps <= 10 * len(heads)


ladders = st.lists(
    st.tuples(st.floats(0.1, 10), st.floats(0, 100), st.integers(0, 2)), min_size=1, max_size=4
)


@given(st.lists(ladders, min_size=1, max_size=4), st.floats(0, 30))
def test_greedy_is_less_than_one_rung_from_the_best_that_exhaustive_search_finds(
    shapes: list[list[tuple[float, float, int]]], left_s: float
) -> None:
    choices = [
        [
            Rung(cost, error, (place, 2, place), place, "both")
            for place, (cost, error, _) in enumerate(shape)
        ]
        for shape in shapes
    ]
    climbers = [
        Climber(
            # Nobody is nearer: the best under that rule is another problem.
            nearness=(float(-index), float(index)),
            ladder=ladder,
            worths=worths,
        )
        for index, (ladder, worths) in enumerate(hull(list(rungs)) for rungs in choices)
    ]
    floor_s = sum(climber.rung.cost_s for climber in climbers)
    before = sum(climber.rung.error for climber in climbers)
    spent_s, _ = climb(climbers, left_s)
    found = sum(climber.rung.error for climber in climbers)
    assert spent_s <= left_s + 1e-9
    best = min(
        sum(rung.error for rung in picks)
        for picks in itertools.product(*choices)
        if sum(rung.cost_s for rung in picks) <= floor_s + left_s
    )
    largest = max(
        (
            low.error - high.error
            for climber in climbers
            for low, high in itertools.pairwise(climber.ladder)
        ),
        default=0.0,
    )
    assert best - 1e-6 <= found <= best + largest + 1e-6
    assert found <= before


def test_against_exhaustive_search_most_of_what_a_budget_can_save_is_saved() -> None:
    """The search may give a farther head more than a nearer one, the plan may not."""
    rng = np.random.default_rng(3)
    shares = []
    for _ in range(12):
        heads = [
            view(
                f"h{i}",
                head_px=float(rng.uniform(60, 500)),
                latent_change=float(rng.uniform(0.05, 0.6)),
            )
            for i in range(4)
        ]
        floor, ample = plan(*heads, budget_s=0.0), plan(*heads)
        for share in (0.2, 0.4, 0.6, 0.8):
            budget_s = floor.cost_s + share * (ample.cost_s - floor.cost_s)
            saved = _squared(heads, floor) - _squared(heads, plan(*heads, budget_s=budget_s))
            shares.append(saved / (_squared(heads, floor) - _best(heads, budget_s)))
    assert max(shares) <= 1 + 1e-9
    assert np.mean(shares) >= 0.93
    assert min(shares) >= 0.7


def _squared(heads: Sequence[HeadView], made: Plan) -> float:
    return sum(made.choices[head.slot].error * head.visible_px for head in heads)


def _best(heads: Sequence[HeadView], budget_s: float) -> float:
    """The least squared error of any combination of what single heads can have."""
    options = []
    for head in heads:
        costs = CostModel()
        extra = head.errors.extra(head.head_px)
        moved = head.errors.latent_mse_per_unit2 * head.latent_change**2
        age = moved + head.errors.view_mse_per_rad2 * head.view_turn_rad**2
        view_s = costs.decode_s("", 256, "expression")
        found = []
        for mesh in range(3):
            found += [(0.0, extra.meshes[mesh] + age, mesh)]
            found += [(view_s, extra.meshes[mesh] + moved, mesh)]
            found += [(costs.decode_s("", 256, "both"), extra.meshes[mesh], mesh)]
        found += [
            (costs.decode_s("", LEVELS[i], "both"), extra.maps[i] + extra.meshes[i], i)
            for i in range(2)
        ]
        pixel_s = costs.draw.pixel_s * head.visible_px
        options.append(
            [
                (
                    decode_s + costs.draw.triangle_s * TRIANGLES[mesh] + pixel_s,
                    (mse + extra.own) * head.visible_px,
                )
                for decode_s, mse, mesh in found
            ]
        )
    left_s = budget_s - ExpectedCosts().draw.frame_s
    return min(
        sum(error for _, error in picks)
        for picks in itertools.product(*options)
        if sum(cost_s for cost_s, _ in picks) <= left_s
    )
