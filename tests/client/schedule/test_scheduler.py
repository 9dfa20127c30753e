"""The scheduler's promises: budget, order, nearness, no old maps, nothing for the unseen."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from copy import copy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.scheduler_heads import (
    AMPLE_S,
    FRAME_S,
    LEVELS,
    NOW_S,
    choose,
    detail,
    plan,
    unseen,
    view,
)
from pica_client.errors import OptionError
from pica_client.schedule.cost_model import CostModel, DrawCost
from pica_client.schedule.head import Head
from pica_client.schedule.scheduler import Plan, Scheduler, SchedulerOptions
from pica_client.schedule.visibility import NOTHING

pytestmark = pytest.mark.unit


# What a single head gets


def test_a_near_talking_head_gets_everything_while_there_is_time() -> None:
    choice = choose(view(head_px=900))
    assert (choice.level, choice.decode, choice.mesh_level) == (256, "both", 256)
    assert choice.every == 1
    assert not choice.is_limited


def test_detail_follows_the_height_on_the_screen() -> None:
    heights = (30, 100, 300, 1000)
    found = [detail(choose(view(head_px=px, held_level=None))) for px in heights]
    assert found == [(1, 64, 64), (1, 128, 128), (1, 256, 128), (1, 256, 256)]


def test_a_head_that_rests_is_not_decoded_again() -> None:
    choice = choose(view(latent_change=0.0, view_turn_rad=0.0))
    assert (choice.decode, choice.level) == ("none", 256)


def test_a_small_difference_is_mended_once_the_maps_are_old() -> None:
    assert choose(view(latent_change=0.02, view_turn_rad=0.0)).decode == "none"
    assert choose(view(latent_change=0.02, view_turn_rad=0.0, age_s=0.3)).decode == "both"


def test_a_view_that_turns_costs_the_expression_map_alone() -> None:
    choice = choose(view(latent_change=0.0, view_turn_rad=0.2))
    assert (choice.decode, choice.level) == ("expression", 256)
    assert choose(view(latent_change=0.0, view_turn_rad=1e-4)).decode == "none"


def test_a_head_without_maps_is_decoded_at_once_even_without_a_budget() -> None:
    choice = choose(view(held_level=None), budget_s=0.0)
    assert (choice.decode, choice.level, choice.mesh_level) == ("both", 64, 64)
    assert choice.is_limited


def test_without_a_budget_a_resting_head_is_drawn_as_coarsely_as_can_be() -> None:
    resting = view(head_px=1000, latent_change=0.0, view_turn_rad=0.0)
    choice = choose(resting, budget_s=0.0)
    assert choice.mesh_level == 64
    assert choice.is_limited
    assert choose(view(head_px=1000, latent_change=0.0, view_turn_rad=0.0)).mesh_level == 256


def test_where_time_is_short_listeners_are_drawn_less_often_before_anybody_is_coarser() -> None:
    people = [view(f"h{i}", head_px=400, latent_change=0.0, view_turn_rad=0.0) for i in range(5)]
    for head in people[1:]:
        head.is_listening = True
    scheduler = Scheduler()
    scheduler.plan(people, AMPLE_S, NOW_S - FRAME_S)
    free = scheduler.plan(people, AMPLE_S, NOW_S)
    short = scheduler.plan(people, 0.7 * free.cost_s, NOW_S + FRAME_S)
    assert (free.is_short, short.is_short) == (False, True)
    assert [detail(choice) for choice in short.choices.values()] == [(1, 256, 128)] * 5
    assert short.cost_s < 0.7 * free.cost_s


# Time


def run(
    scheduler: Scheduler,
    heads: Sequence[Head],
    budget_s: float,
    seconds: float,
    *,
    frame_s: float = FRAME_S,
    latent_speed: float = 6.0,
) -> list[tuple[float, Plan]]:
    """A scene in which what is chosen is decoded, and what is not grows older."""
    for head in heads:
        head.asked_s = head.latent_asked_s = 0.0
    plans = []
    for frame in range(round(seconds / frame_s)):
        now = (frame + 1) * frame_s
        for head in heads:
            head.latent_change = latent_speed * (now - head.latent_asked_s)
        plans.append((now, scheduler.plan(heads, budget_s, now)))
        for head in heads:
            head.request(now)
    return plans


@pytest.mark.parametrize("frame_s", [1 / 30, 1 / 72, 1 / 240])
def test_nobody_s_maps_grow_old_whatever_the_budget(frame_s: float) -> None:
    heads = [view(f"h{i}", head_px=400 / (i + 1)) for i in range(6)]
    last = dict.fromkeys((head.slot for head in heads), 0.0)
    worst = 0.0
    for now, made in run(Scheduler(), heads, 0.0, 4.0, frame_s=frame_s):
        for slot, choice in made.choices.items():
            if choice.decode == "both":
                last[slot] = now
            worst = max(worst, now - last[slot])
    assert worst <= SchedulerOptions().max_age_s + frame_s + 1e-9


@pytest.mark.parametrize("latent_speed", [0.01, 0.1, 1.0])
def test_a_head_that_turns_all_the_time_still_gets_its_small_changes(latent_speed: float) -> None:
    head = view()  # its view turns in every frame, which alone asks for expression maps
    options, last, worst = SchedulerOptions(), 0.0, 0.0
    for now, made in run(Scheduler(options), [head], AMPLE_S, 2.0, latent_speed=latent_speed):
        last = now if made.choices[head.slot].decode == "both" else last
        worst = max(worst, now - last)
    assert worst <= options.max_age_s / 2 + FRAME_S + 1e-9


def test_with_a_small_budget_heads_take_turns_and_not_all_in_one_frame() -> None:
    heads = [view(f"h{i}", head_px=200) for i in range(8)]
    plans = run(Scheduler(), heads, 0.0, 4.0)[30:]
    decodes = [sum(c.decode != "none" for c in made.choices.values()) for _, made in plans]
    assert max(decodes) <= 4


@pytest.mark.parametrize("hertz", [30, 72, 200, 240])
def test_a_fast_display_or_a_fast_tracker_stays_within_the_budget_on_average(hertz: int) -> None:
    heads = [view(f"h{i}", head_px=250) for i in range(5)]
    budget_s = 0.035
    plans = [made for _, made in run(Scheduler(), heads, budget_s, 2.0, frame_s=1 / hertz)[5:]]
    assert sum(made.cost_s for made in plans) / len(plans) <= budget_s
    decode_s = CostModel().decode_s("", 256, "both")
    for made in plans:
        assert made.cost_s <= max(budget_s, made.floor_s) + decode_s


def test_levels_do_not_flap_when_a_head_sways_at_the_edge_of_a_level() -> None:
    scheduler, options = Scheduler(), SchedulerOptions()
    for edge_px in (options.full_px, *options.mesh_px):
        head, found = view(held_level=64), []
        for frame in range(300):
            sway = edge_px * (1 + 0.05 * math.sin(frame))
            head.sight = head.sight._replace(head_px=sway)
            choice = scheduler.plan([head], AMPLE_S, frame * FRAME_S).choices["ada"]
            head.request(frame * FRAME_S)
            found.append(detail(choice))
        assert sum(a != b for a, b in itertools.pairwise(found)) <= 1


def test_levels_do_not_flap_when_the_budget_is_on_the_edge() -> None:
    scheduler = Scheduler()
    head = view(head_px=1000)
    full_s = choose(view(head_px=1000)).cost_s + DrawCost().frame_s
    found = []
    for frame in range(900):
        budget_s = full_s + 1e-4 * (1 if frame % 2 else -1)
        found.append(detail(scheduler.plan([head], budget_s, frame * FRAME_S).choices["ada"]))
        head.request(frame * FRAME_S)
    assert sum(a != b for a, b in itertools.pairwise(found)) <= 2


def test_heads_of_one_height_lose_detail_one_after_the_other() -> None:
    names = ("ada", "bea", "cho", "dan")
    whole_s = plan(*(view(name) for name in names)).cost_s
    found = set()
    for share in np.linspace(1, 0.6, 30):
        choices = plan(*(view(name) for name in names), budget_s=share * whole_s).choices
        found.add(sum(choice.scale < 1 for choice in choices.values()))
    assert found == {0, 1, 2, 3, 4}


def test_two_heads_that_sway_side_by_side_do_not_take_detail_from_each_other() -> None:
    heads = [view("ada"), view("bea")]
    scheduler, found = Scheduler(), []
    budget_s = 0.8 * plan(*copies(heads)).cost_s
    for frame in range(90):
        for number, head in enumerate(heads):
            height = 300 * (1 + 0.03 * np.sin(frame / 5 + np.pi * number))
            head.sight = head.sight._replace(head_px=height)
        made = scheduler.plan(heads, budget_s, frame * FRAME_S)
        found.append(tuple(choice.mesh_level for choice in made.choices.values()))
    assert len(set(found[30:])) == 1


def test_detail_that_the_budget_took_comes_back_with_the_budget() -> None:
    scheduler, head = Scheduler(), view(head_px=1000)
    assert detail(scheduler.plan([head], 0.0, 1.0).choices["ada"]) == (0.5, 64, 64)
    assert detail(scheduler.plan([head], AMPLE_S, 2.0).choices["ada"]) == (1, 256, 256)


def test_a_head_that_leaves_is_wanted_a_while_longer_and_then_not_at_all() -> None:
    scheduler, head = Scheduler(), view()
    sight = head.sight
    wanted = []
    for frame in range(90):
        head.sight = sight if frame < 10 else NOTHING
        made = scheduler.plan([head], AMPLE_S, frame * FRAME_S)
        wanted.append(made.choices["ada"].every)
    hold_s = SchedulerOptions().stream_hold_s
    last = max(i for i, every in enumerate(wanted) if every)
    assert (last - 9) * FRAME_S == pytest.approx(hold_s, abs=1.5 * FRAME_S)
    head.sight = sight
    assert scheduler.plan([head], AMPLE_S, 3.1).choices["ada"].every == 1


def test_a_head_that_comes_back_is_decoded_in_the_same_frame() -> None:
    scheduler, ada, ben = Scheduler(), view(age_s=103.0), view("ben")
    sight, ada.sight = ada.sight, NOTHING
    for frame in range(90):
        scheduler.plan([ada, ben], 0.001, frame * FRAME_S)
    ada.sight = sight
    assert scheduler.plan([ada, ben], 0.001, 3.0).choices["ada"].decode == "both"


def test_a_small_or_mostly_hidden_head_wants_fewer_layers() -> None:
    layers = [choose(view(head_px=px)).every for px in (5, 20, 200)]
    assert layers == [4, 2, 1]
    assert choose(view(head_px=60, hidden_ratio=0.9)).every == 2


def test_two_eyes_decode_once_and_draw_twice() -> None:
    decode_s = CostModel().decode_s("", 256, "both")
    cost_of_one, cost_of_two = choose(view()).cost_s, choose(view(num_views=2)).cost_s
    assert cost_of_two - decode_s == pytest.approx(2 * (cost_of_one - decode_s))


def test_the_plan_says_from_whom_the_budget_kept_something() -> None:
    made = plan(view("near", head_px=1000), view("far", head_px=60), budget_s=0.008)
    assert any(choice.is_limited for choice in made.choices.values())
    free = plan(view("near", head_px=1000), view("far", head_px=60))
    assert not any(choice.is_limited for choice in free.choices.values())


# Whatever the heads


@st.composite
def head_views(draw: st.DrawFn, slot: str = "ada", age_s: float | None = None) -> Head:
    """Any head that can be."""
    head = view(
        slot,
        head_px=draw(st.floats(0.5, 2000)),
        hidden_ratio=draw(st.floats(0, 0.97)),
        held_level=draw(st.sampled_from([None, *LEVELS])),
        latent_change=draw(st.one_of(st.just(0.0), st.floats(0, 3))),
        view_turn_rad=draw(st.one_of(st.just(0.0), st.floats(0, 1))),
        age_s=draw(st.floats(0, 1)),
        num_views=draw(st.integers(1, 2)),
    )
    if draw(st.integers(0, 3)) == 0:
        head.sight = NOTHING
    return head


@st.composite
def scenes(draw: st.DrawFn) -> list[Head]:
    return [draw(head_views(slot=f"h{i}")) for i in range(draw(st.integers(1, 6)))]


budgets = st.floats(0, 0.08)


def copies(heads: Sequence[Head]) -> list[Head]:
    """The same heads with a memory of their own."""
    return [copy(head) for head in heads]


@pytest.mark.slow
@given(scenes(), budgets)
def test_the_budget_is_kept_whenever_the_floor_fits(heads: list[Head], budget_s: float) -> None:
    made = plan(*heads, budget_s=budget_s)
    # The oldest is decoded in any case, which may reach over by as much as that takes.
    decode_s = max(CostModel().decode_s("", level, "both") for level in LEVELS)
    assert made.cost_s <= max(budget_s, made.floor_s) + len(heads) * decode_s
    if all(head.asked and NOW_S - head.asked_s < 0.25 for head in heads):
        assert made.cost_s <= max(budget_s, made.floor_s) + decode_s
    frame_s = DrawCost().frame_s if any(h.sight.is_visible for h in heads) else 0.0
    shares = sum(choice.cost_s for choice in made.choices.values())
    assert shares + frame_s == pytest.approx(made.cost_s)


@pytest.mark.slow
@given(scenes(), budgets, st.randoms(use_true_random=False))
def test_the_plan_does_not_depend_on_the_order_of_heads(
    heads: list[Head], budget_s: float, random: object
) -> None:
    shuffled = copies(heads)
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    one, other = plan(*heads, budget_s=budget_s), plan(*shuffled, budget_s=budget_s)
    assert dict(one.choices) == dict(other.choices)
    assert one.cost_s == pytest.approx(other.cost_s)


@pytest.mark.slow
@given(scenes(), budgets, budgets)
def test_more_budget_never_means_less_detail(
    heads: list[Head], budget_s: float, more_s: float
) -> None:
    small = plan(*copies(heads), budget_s=budget_s)
    large = plan(*heads, budget_s=budget_s + more_s)
    for slot, choice in small.choices.items():
        if "none" not in (choice.decode, large.choices[slot].decode):
            assert detail(large.choices[slot]) >= detail(choice)


@pytest.mark.slow
@given(
    head_views(slot="far"),
    st.floats(1.001, 8),
    st.lists(head_views(slot="third"), max_size=1),
    budgets,
)
def test_nearer_never_gets_less_than_farther_with_the_same_past(
    far: Head, factor: float, others: list[Head], budget_s: float
) -> None:
    near = copy(far)
    near.slot = "near"
    near.sight = far.sight._replace(
        head_px=far.sight.head_px * factor, visible_px=far.sight.visible_px * factor**2
    )
    choices = plan(far, near, *others, budget_s=budget_s).choices
    near_choice, far_choice = choices["near"], choices["far"]
    assert near_choice.decode != "none" or far_choice.decode == "none" or factor > 1
    if near_choice.decode == far_choice.decode:
        assert detail(near_choice) >= detail(far_choice)
    layers = [4 // c.every if c.every else 0 for c in (near_choice, far_choice)]
    assert layers[0] >= layers[1]


@pytest.mark.slow
@given(scenes(), head_views(slot="gone"), budgets)
def test_an_unseen_head_costs_nothing_and_takes_nothing_from_the_others(
    heads: list[Head], gone: Head, budget_s: float
) -> None:
    gone.sight = NOTHING
    alone = plan(*copies(heads), budget_s=budget_s)
    together = plan(*heads, gone, budget_s=budget_s)
    choice = together.choices["gone"]
    assert (choice.decode, choice.cost_s) == ("none", 0.0)
    assert {slot: together.choices[slot] for slot in alone.choices} == dict(alone.choices)


@pytest.mark.parametrize(
    "changes", [{"max_age_s": 0.0}, {"least_change": -1.0}, {"share_px": (9.0, 3.0)}]
)
def test_options_that_make_no_sense_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(OptionError, match=next(iter(changes))):
        SchedulerOptions(**changes)  # type: ignore[arg-type]


def test_nobody_there_costs_nothing() -> None:
    made = plan()
    assert (made.cost_s, dict(made.choices)) == (0.0, {})


def test_behind_the_viewer_nothing_is_decoded() -> None:
    assert choose(unseen()).decode == "none"


def test_the_expression_map_of_a_face_at_rest_is_as_new_as_its_sample() -> None:
    head = view(latent_change=0.0)
    head.captured_us = 33_000
    plan(head)
    request = head.request(NOW_S)
    assert request is not None
    assert (request.parts, request.captured_us) == ("expression", 33_000)


def test_an_expression_map_for_an_older_latent_says_its_age() -> None:
    head = view(latent_change=0.01)
    head.captured_us, head.latent = 33_000, head.latent + 0.01
    plan(head)
    request = head.request(NOW_S)
    assert request is not None
    assert (request.parts, request.captured_us) == ("expression", 0)
