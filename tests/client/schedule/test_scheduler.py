"""The scheduler's promises: budget, order, nearness, no old maps, nothing for the unseen."""

import itertools
import math
from collections.abc import Sequence
from copy import copy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.decode.request import DecodedMaps, DecodeRequest, DecodeResult
from pica_client.schedule.cost_model import CostModel
from pica_client.schedule.head import Choice, Head
from pica_client.schedule.scheduler import DETAIL_PX, MAX_AGE_S, Plan, Scheduler
from pica_client.schedule.visibility import NOTHING, Sight
from pica_core.types import LATENT_SHAPE

pytestmark = pytest.mark.unit

TOY = with_toy_levels(make_toy_avatar())
LEVELS = TOY.levels
TRIANGLES = (4_000, 16_000, 50_000)
FRAME_S = 1 / 30
NOW_S = 100.0
AMPLE_S = 10.0
LATENT = np.zeros(LATENT_SHAPE, np.float32)
AHEAD = np.array([0, 0, 1], np.float32)


def view(
    slot: str = "ada",
    head_px: float = 300.0,
    *,
    held_level: int | None = 128,
    age_s: float = FRAME_S,
    num_views: int = 1,
    latent_change: float = 0.3,
    view_turn_rad: float = 0.01,
) -> Head:
    """A talking head of this height, decoded one frame ago."""
    head = Head(slot=slot, avatar=TOY)
    head.num_triangles = TRIANGLES
    head.sight = Sight(0.6 * num_views * head_px * head_px, head_px, num_views)
    head.latent_change, head.view_turn_rad = latent_change, view_turn_rad
    if held_level is not None:
        head.asked = DecodeRequest(LATENT, AHEAD, 0, held_level)
        head.asked_s = head.latent_asked_s = NOW_S - age_s
    return head


def plan(*heads: Head, budget_s: float = AMPLE_S) -> Plan:
    """A plan of a frame, by a scheduler that has planned no other."""
    return Scheduler().plan(heads, budget_s, now=NOW_S)


def choose(head: Head, budget_s: float = AMPLE_S) -> Choice:
    """What a head alone gets."""
    return plan(head, budget_s=budget_s).choices[head.slot]


def detail(choice: Choice) -> tuple[float, int]:
    """How fine a head is drawn."""
    return choice.scale, choice.level


# What a single head gets


@pytest.mark.parametrize(
    ("latent_change", "view_turn_rad", "age_s", "decode"),
    [
        (0.3, 0.01, FRAME_S, "both"),
        (0.0, 0.0, FRAME_S, "none"),
        (0.02, 0.0, FRAME_S, "none"),  # a small difference is mended once the maps are old
        (0.02, 0.0, 0.3, "both"),
        (0.0, 0.2, FRAME_S, "expression"),
        (0.0, 1e-4, FRAME_S, "none"),
    ],
)
def test_what_has_changed_is_decoded(
    latent_change: float, view_turn_rad: float, age_s: float, decode: str
) -> None:
    head = view(latent_change=latent_change, view_turn_rad=view_turn_rad, age_s=age_s)
    choice = choose(head)
    assert (choice.decode, choice.level) == (decode, 128)


def test_detail_and_the_part_of_a_stream_follow_the_height_on_the_screen() -> None:
    heights = (30, 100, 300, 1000)
    found = [detail(choose(view(head_px=px, held_level=None))) for px in heights]
    assert found == [(1, 64), (1, 128), (1, 128), (1, 256)]
    assert [choose(view(head_px=px)).every for px in (5, 20, 200)] == [4, 2, 1]


def test_where_time_is_short_listeners_are_drawn_less_often_before_anybody_is_coarser() -> None:
    people = [view(f"h{i}", head_px=400, latent_change=0.0, view_turn_rad=0.0) for i in range(5)]
    for head in people[1:]:
        head.is_listening = True
    scheduler = Scheduler()
    scheduler.plan(people, AMPLE_S, NOW_S - FRAME_S)
    free = scheduler.plan(people, AMPLE_S, NOW_S)
    short = scheduler.plan(people, 0.7 * free.cost_s, NOW_S + FRAME_S)
    assert (free.is_short, short.is_short) == (False, True)
    assert [detail(choice) for choice in short.choices.values()] == [(1, 128)] * 5
    assert short.cost_s < 0.7 * free.cost_s
    assert [choice.every for choice in free.choices.values()] == [1] * 5
    assert [choice.every for choice in short.choices.values()] == [1, 2, 2, 2, 2]


def test_what_a_budget_has_no_time_for_in_this_image_is_decoded_in_the_next() -> None:
    """Images come twice as often as faces here, and all faces at once."""
    people = [view(f"h{i}", age_s=FRAME_S / 2) for i in range(5)]
    scheduler = Scheduler()
    for frame in range(200, 0, -1):  # the time between two is an average
        scheduler.plan(people, AMPLE_S, NOW_S - frame * FRAME_S / 2)
    free = scheduler.plan(people, AMPLE_S, NOW_S)
    decode_s = scheduler.costs.decode_s(people[0].model, 128, "both")
    budget_s = free.cost_s - 2.4 * decode_s
    short = scheduler.plan(people, budget_s, NOW_S + FRAME_S / 2)
    assert [choice.decode for choice in free.choices.values()] == ["both"] * 5
    assert [choice.level for choice in short.choices.values()] == [128] * 5
    assert [choice.decode for choice in short.choices.values()].count("both") == 2
    assert short.cost_s <= budget_s


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
    assert worst <= MAX_AGE_S + frame_s + 1e-9


@pytest.mark.parametrize("latent_speed", [0.01, 0.1, 1.0])
def test_a_head_that_turns_all_the_time_still_gets_its_small_changes(latent_speed: float) -> None:
    head = view()  # its view turns in every frame, which alone asks for expression maps
    last = worst = 0.0
    for now, made in run(Scheduler(), [head], AMPLE_S, 2.0, latent_speed=latent_speed):
        last = now if made.choices[head.slot].decode == "both" else last
        worst = max(worst, now - last)
    assert worst <= MAX_AGE_S / 2 + FRAME_S + 1e-9


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
    assert max(made.cost_s for made in plans) <= budget_s + decode_s


def test_levels_do_not_flap_when_a_head_sways_at_the_edge_of_a_level() -> None:
    scheduler = Scheduler()
    for edge_px in DETAIL_PX:
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
    full_s = plan(view(head_px=1000)).cost_s
    found = []
    for frame in range(900):
        budget_s = full_s + 1e-4 * (1 if frame % 2 else -1)
        found.append(detail(scheduler.plan([head], budget_s, frame * FRAME_S).choices["ada"]))
        head.request(frame * FRAME_S)
    assert sum(a != b for a, b in itertools.pairwise(found)) <= 2


@pytest.mark.parametrize("budget_s", [0.010, 0.014])
def test_levels_do_not_flap_when_frames_come_unevenly(budget_s: float) -> None:
    """As they do on a busy machine, where three of four only listen."""
    heads = [view(f"h{i}", head_px=300) for i in range(4)]
    for head in heads[1:]:
        head.is_listening = True
    scheduler, rng, now, found = Scheduler(), np.random.default_rng(0), 0.0, []
    for _ in range(600):
        now += rng.uniform(0.4, 1.6) * FRAME_S
        made = scheduler.plan(heads, budget_s, now)
        for head in heads:
            head.request(now)
        found.append(tuple(detail(choice) for choice in made.choices.values()))
    assert sum(a != b for a, b in itertools.pairwise(found[100:])) <= 20


def test_heads_of_one_height_lose_detail_one_after_the_other() -> None:
    names = ("ada", "bea", "cho", "dan")
    whole = plan(*(view(name) for name in names))
    found = set()
    for share in np.linspace(1, 0.6, 30):
        choices = plan(*(view(name) for name in names), budget_s=share * whole.cost_s).choices
        found.add(sum(choice.level < whole.choices["ada"].level for choice in choices.values()))
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
        found.append(tuple(choice.level for choice in made.choices.values()))
    assert len(set(found[30:])) == 1


def test_detail_that_the_budget_took_comes_back_with_the_budget() -> None:
    scheduler, head = Scheduler(), view(head_px=1000)
    assert detail(scheduler.plan([head], 0.0, 1.0).choices["ada"]) == (0.5, 64)
    assert detail(scheduler.plan([head], AMPLE_S, 2.0).choices["ada"]) == (1, 256)


def test_what_is_measured_reaches_the_cost_model() -> None:
    scheduler, head = Scheduler(), view()
    maps = DecodedMaps(None, None, 256)
    result = DecodeResult("ada", maps, None, started_s=0.0, finished_s=0.05)
    scheduler.note_decoded(head, result, 1e-3)
    assert scheduler.costs.decode_s(head.model, 256, "both") == pytest.approx(0.051)


# Whatever the heads


@st.composite
def head_views(draw: st.DrawFn, slot: str = "ada", age_s: float | None = None) -> Head:
    """Any head that can be."""
    head = view(
        slot,
        head_px=draw(st.floats(0.5, 2000)),
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
def test_the_budget_is_kept_whenever_the_least_fits(heads: list[Head], budget_s: float) -> None:
    least_s = plan(*copies(heads), budget_s=0.0).cost_s
    made = plan(*heads, budget_s=budget_s)
    # The oldest is decoded in any case, which may reach over by as much as that takes.
    is_overdue = any(not head.asked or NOW_S - head.asked_s >= MAX_AGE_S for head in heads)
    num_decodes = len(heads) if is_overdue else 1
    decode_s = max(CostModel().decode_s("", level, "both") for level in LEVELS)
    assert made.cost_s <= max(budget_s, least_s) + num_decodes * decode_s


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
    assert together.choices["gone"].decode == "none"
    assert {slot: together.choices[slot] for slot in alone.choices} == dict(alone.choices)
    assert together.cost_s == alone.cost_s
