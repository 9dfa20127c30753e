"""The scheduler's promises: budget, order, nearness, nobody starved, nothing for the unseen."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from helpers.scheduler_heads import (
    AMPLE_S,
    FRAME_S,
    LEVELS,
    amount,
    choose,
    gentle,
    plan,
    unseen,
    view,
)
from pica_client.errors import OptionError
from pica_client.schedule.cost_model import CostModel, ExpectedCosts
from pica_client.schedule.error_model import ErrorModel
from pica_client.schedule.scheduler import HeadView, Plan, Scheduler, SchedulerOptions
from pica_core.avatar.levels import LevelErrors, default_errors
from pica_protocol.limits import MAX_LAYER

pytestmark = pytest.mark.unit


# What a single head gets


def test_a_near_talking_head_gets_everything_while_there_is_time() -> None:
    choice = choose(view(head_px=900))
    assert (choice.level, choice.decode, choice.mesh_level) == (256, "both", 256)
    assert choice.wanted_layer == MAX_LAYER
    assert not choice.is_limited
    assert choice.error == pytest.approx(5.0)  # the full level's own, from the table


def test_a_head_gets_no_more_detail_than_can_be_seen() -> None:
    measured = LevelErrors(
        levels=LEVELS,
        head_px=np.array([32, 128, 512], np.float32),
        mse=np.array(
            [
                [[2.4, 9, 60], [2.1, 5, 30]],
                [[2.1, 2.4, 20], [2.1, 2.2, 10]],
                [[2, 2, 2], [2, 2, 2]],
            ],
            np.float32,
        ),
        view_mse_per_rad2=100,
        latent_mse_per_unit2=100,
    )
    errors = ErrorModel(measured)
    levels = [
        choose(view(head_px=px, errors=errors, held_level=None)).level for px in (30, 128, 500)
    ]
    assert levels == [64, 128, 256]


def test_of_what_is_as_good_as_can_be_seen_the_cheapest_is_taken() -> None:
    sharp_maps = default_errors(LEVELS)
    mse = np.array(sharp_maps.mse)
    mse[:, 1] = mse[-1:, 1]  # no mesh leaves anything
    errors = ErrorModel(replace(sharp_maps, mse=mse))
    choice = choose(view(head_px=900, errors=errors))
    assert (choice.level, choice.mesh_level, choice.is_limited) == (256, 64, False)


def test_what_too_few_pixels_leave_anyway_hides_some_lack_of_detail() -> None:
    table = default_errors(LEVELS)
    rough = ErrorModel(replace(table, mse=table.mse + np.float32(500)))
    assert choose(view(errors=ErrorModel(table))).level == 256
    assert choose(view(errors=rough)).level == 64


def test_a_head_that_rests_is_not_decoded_again() -> None:
    choice = choose(view(latent_change=0.0, view_turn_rad=0.0))
    assert (choice.decode, choice.level) == ("none", 256)


def test_a_difference_too_small_to_see_is_mended_once_the_face_rests() -> None:
    moving = view(latent_change=0.02, view_turn_rad=0.0)
    assert choose(moving).decode == "none"
    assert choose(replace(moving, age_s=0.3)).decode == "both"


def test_a_view_that_turns_costs_the_expression_map_alone() -> None:
    choice = choose(view(latent_change=0.0, view_turn_rad=0.2))
    assert (choice.decode, choice.level) == ("expression", 256)
    assert choose(view(latent_change=0.0, view_turn_rad=0.01)).decode == "none"


def test_a_head_without_maps_is_decoded_at_once_even_without_a_budget() -> None:
    choice = choose(view(held_level=None, age_s=math.inf), budget_s=0.0)
    assert (choice.decode, choice.level, choice.mesh_level) == ("both", 64, 64)
    assert choice.is_limited


def test_maps_finer_than_can_be_seen_are_kept_but_drawn_with_a_coarser_mesh() -> None:
    small = view(head_px=16, latent_change=0.0, view_turn_rad=0.0, errors=gentle())
    choice = choose(small)
    assert (choice.decode, choice.level, choice.mesh_level) == ("none", 256, 64)


def test_maps_are_kept_with_fewer_triangles_where_the_budget_has_no_room_for_theirs() -> None:
    resting = view(head_px=600, latent_change=0.0, view_turn_rad=0.0)
    choice = choose(resting, budget_s=0.0)
    assert (choice.decode, choice.level, choice.mesh_level) == ("none", 256, 64)
    assert choice.is_limited
    assert choose(resting).mesh_level == 256


def test_fast_motion_hides_detail_and_not_age() -> None:
    still, fast = (choose(view(speed_px_s=speed), 0.0085) for speed in (0.0, 9000.0))
    assert still.is_limited
    assert still.error > fast.error
    assert choose(view(speed_px_s=6000.0, age_s=1.0), 0.0).decode == "both"


# Time


def run(
    scheduler: Scheduler,
    heads: Sequence[HeadView],
    budget_s: float,
    seconds: float,
    *,
    frame_s: float = FRAME_S,
    latent_speed: float = 6.0,
    begin_s: float = 0.0,
) -> list[tuple[float, Plan]]:
    """A scene in which what is chosen is decoded, and what is not grows older."""
    decoded_s = {head.slot: begin_s for head in heads}
    held = {head.slot: head.held_level for head in heads}
    plans = []
    for frame in range(round(seconds / frame_s)):
        now = begin_s + (frame + 1) * frame_s
        seen = [
            replace(
                head,
                held_level=held[head.slot],
                age_s=now - decoded_s[head.slot],
                latent_change=latent_speed * (now - decoded_s[head.slot]),
            )
            for head in heads
        ]
        made = scheduler.plan(seen, budget_s, now)
        for slot, choice in made.choices.items():
            if choice.decode == "both":
                decoded_s[slot], held[slot] = now, choice.level
        plans.append((now, made))
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


def test_with_a_small_budget_heads_take_turns_and_not_all_in_one_frame() -> None:
    heads = [view(f"h{i}", head_px=200) for i in range(8)]
    plans = run(Scheduler(), heads, 0.0, 4.0)[30:]
    decodes = [sum(c.decode != "none" for c in made.choices.values()) for _, made in plans]
    assert max(decodes) <= 4


@pytest.mark.parametrize("hertz", [72, 200, 240])
def test_a_fast_display_or_a_fast_tracker_stays_within_the_budget(hertz: int) -> None:
    heads = [view(f"h{i}", head_px=250) for i in range(5)]
    budget_s = 0.018
    for _, made in run(Scheduler(), heads, budget_s, 2.0, frame_s=1 / hertz)[5:]:
        assert made.cost_s <= max(budget_s, made.floor_s) + 1e-12


def test_levels_do_not_flap_when_a_head_sways_at_the_edge_of_a_level() -> None:
    errors, scheduler = gentle(), Scheduler()
    edges = [px for px in range(17, 300) if _needed(errors, px) != _needed(errors, px + 1)]
    changes = 0
    before = None
    for frame in range(300):
        sway = edges[0] + 0.5 + 3 * math.sin(frame)
        head = view(head_px=sway, errors=errors, latent_change=0.5, held_level=before or 64)
        level = scheduler.plan([head], AMPLE_S, frame * FRAME_S).choices["ada"].level
        changes += before is not None and level != before
        before = level
    assert changes <= 1


def _needed(errors: ErrorModel, px: float) -> int:
    extra = errors.extra(px)
    unseen = max(SchedulerOptions().floor_mse, SchedulerOptions().floor_ratio * extra.own) / 2
    return next(i for i, mse in enumerate(extra.maps) if mse <= unseen)


def test_levels_do_not_flap_when_the_budget_is_on_the_edge() -> None:
    scheduler = Scheduler()
    head = view(head_px=500)
    full = choose(head).cost_s + ExpectedCosts().draw.frame_s
    levels = []
    for frame in range(900):
        budget_s = full + 1e-4 * (1 if frame % 2 else -1)
        levels.append(scheduler.plan([head], budget_s, frame * FRAME_S).choices["ada"].level)
    changes = [t for t, (a, b) in enumerate(itertools.pairwise(levels)) if a != b]
    assert len(changes) <= 14  # up and down again at pauses of 0.5, 1, 2, 4, 8 s
    assert len([t for t in changes if t > 450]) <= 6


def test_a_head_that_leaves_is_wanted_a_while_longer_and_then_not_at_all() -> None:
    scheduler = Scheduler()
    wanted = []
    for frame in range(90):
        head = view() if frame < 10 else unseen()
        made = scheduler.plan([head], AMPLE_S, frame * FRAME_S)
        wanted.append(made.choices["ada"].wanted_layer)
    hold_s = SchedulerOptions().wish_hold_s
    last = max(i for i, layer in enumerate(wanted) if layer is not None)
    assert (last - 9) * FRAME_S == pytest.approx(hold_s, abs=1.5 * FRAME_S)
    assert scheduler.plan([view()], AMPLE_S, 3.1).choices["ada"].wanted_layer == MAX_LAYER


def test_a_head_that_comes_back_is_decoded_in_the_same_frame() -> None:
    scheduler = Scheduler()
    for frame in range(90):
        scheduler.plan([unseen(), view("ben")], 0.001, frame * FRAME_S)
    back = view(age_s=3.0, latent_change=2.0)
    assert scheduler.plan([back, view("ben")], 0.001, 3.0).choices["ada"].decode == "both"


def test_a_small_or_mostly_hidden_head_wants_fewer_layers() -> None:
    layers = [choose(view(head_px=px)).wanted_layer for px in (5, 20, 200)]
    assert layers == [0, 1, MAX_LAYER]
    assert choose(view(head_px=60, hidden_ratio=0.9)).wanted_layer == 1


def test_two_eyes_decode_once_and_draw_twice() -> None:
    one, two = view(), view(num_views=2, drawn_px=2 * view().visible_px)
    costs = CostModel()
    decode_s = costs.decode_s("", 256, "both")
    cost_of_one, cost_of_two = choose(one).cost_s, choose(two).cost_s
    assert cost_of_two - decode_s == pytest.approx(2 * (cost_of_one - decode_s))


def test_who_faded_because_the_stream_fell_silent_comes_last() -> None:
    live, stale = view("live"), view("stale", is_stale=True)
    budget_s = plan(live, stale).cost_s * 0.7
    made = plan(live, stale, budget_s=budget_s)
    assert amount(made.choices["live"]) > amount(made.choices["stale"])


def test_the_plan_says_from_whom_the_budget_kept_something() -> None:
    near, far = view("near", head_px=600), view("far", head_px=60)
    made = plan(near, far, budget_s=0.008)
    assert made.limited
    assert all(made.choices[slot].is_limited for slot in made.limited)
    assert plan(near, far).limited == ()


# Bad input


@pytest.mark.parametrize(
    "changes",
    [
        {"visible_px": math.nan},
        {"head_px": -1.0},
        {"latent_change": math.inf},
        {"num_triangles": (1, 2)},
        {"held_level": 100},
    ],
)
def test_a_head_that_cannot_be_is_refused(changes: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="head ada"):
        view(**changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "changes", [{"max_age_s": 0.0}, {"margin": 2.0}, {"layer_px": (9.0, 3.0)}, {"floor_ratio": -1}]
)
def test_options_that_make_no_sense_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(OptionError, match=next(iter(changes))):
        SchedulerOptions(**changes)  # type: ignore[arg-type]


def test_nobody_there_costs_nothing() -> None:
    made = plan()
    assert (made.cost_s, made.error, dict(made.choices)) == (0.0, 0.0, {})
