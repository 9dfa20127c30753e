"""Layouts: nobody sits in somebody else, everybody is in the picture, with room for their names."""

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.render.scene import Rect, common_px, head_rect_px, view_direction
from pica_client.render.seats import (
    LAYOUTS,
    MAX_SHOULDERS_M,
    MIN_SHOULDERS_M,
    SHOULDER_DEPTH_M,
    FreeShares,
    Layout,
    SeatPlan,
    plan_seats,
)
from pica_client.render.views import (
    KEPT_DEGREES,
    NEAREST_M,
    USUAL_SPAN,
    ViewState,
    orbit_limits,
    plan_camera,
)
from pica_core.avatar.manifest import ViewSpan
from pica_core.camera import Camera
from pica_core.types import Float64Array

pytestmark = pytest.mark.unit

WIDTH = 1280
LABEL_PX_OF_HEIGHT = 0.055
"""A name of one line, as part of the picture's height."""
SIZES = [(320, 240), (480, 800), (640, 360), (1280, 720), (2560, 1080), (3840, 2160)]
layouts = st.sampled_from(LAYOUTS)
counts = st.integers(1, 5)
aspects = st.floats(0.5, 2.6)
pins = st.none() | st.integers(0, 4)


def picture(plan: SeatPlan, aspect: float) -> tuple[Camera, list[Rect]]:
    camera = plan_camera(plan, ViewState(), WIDTH, round(WIDTH / aspect))
    rects = [head_rect_px(camera, seat) for seat in plan.seats]
    assert None not in rects
    return camera, [rect for rect in rects if rect is not None]


@given(layout=layouts, count=counts, aspect=aspects, pinned=pins)
def test_everybody_is_in_the_picture_and_nobody_hides_a_head_or_its_name(
    layout: Layout, count: int, aspect: float, pinned: int | None
) -> None:
    camera, rects = picture(plan_seats(layout, count, aspect, pinned=pinned), aspect)
    label = LABEL_PX_OF_HEIGHT * camera.height
    assert len(rects) == count
    for left, top, right, bottom in rects:
        assert -0.5 <= left < right <= camera.width + 0.5
        assert -0.5 <= top < bottom <= camera.height - label + 0.5
    for first, second in combinations(rects, 2):
        # Room for movement may be shared a little; the heads themselves are not so wide.
        assert common_px(shrunk(first), shrunk(second)) == 0
        for upper, lower in ((first, second), (second, first)):
            name = (upper[0], upper[3], upper[2], upper[3] + label)
            assert common_px(shrunk(name), shrunk(lower)) == 0


def shrunk(rect: Rect) -> Rect:
    left, top, right, bottom = rect
    x = 0.15 * (right - left)
    return left + x, top + 1, right - x, bottom - 1


@given(
    layout=layouts,
    count=counts,
    aspect=aspects,
    pinned=pins,
    top=st.floats(0, 0.5),
    right=st.floats(0, 0.5),
)
def test_what_is_to_be_kept_free_is_free(
    layout: Layout, count: int, aspect: float, pinned: int | None, top: float, right: float
) -> None:
    free = FreeShares(top=top, right=right)
    plan = plan_seats(layout, count, aspect, pinned=pinned, free=free)
    camera, rects = picture(plan, aspect)
    for _, upper, end, bottom in rects:
        assert end <= (1 - right) * camera.width + 0.5
        assert upper >= top * camera.height - 0.5
        assert bottom <= camera.height + 0.5


@given(layout=layouts, count=st.integers(2, 5), aspect=aspects, data=st.data())
def test_whoever_is_pinned_is_much_larger_than_the_others_who_begin_below_the_chest(
    layout: Layout, count: int, aspect: float, data: st.DataObject
) -> None:
    pinned = data.draw(st.integers(0, count - 1))
    plan = plan_seats(layout, count, aspect, pinned=pinned)
    camera, rects = picture(plan, aspect)
    chest, _ = camera.project(plan.seats[pinned][:3, 3] - np.array([0, 0.255, -0.07]))
    _, top, _, bottom = rects.pop(pinned)
    for _, upper, _, lower in rects:
        assert bottom - top > (1.8 if 1.2 <= aspect <= 2.4 else 1) * (lower - upper)
        assert aspect >= 1 or upper >= chest[1] - 1


@given(layout=layouts, count=st.integers(1, 16), aspect=aspects, pinned=pins)
def test_seats_are_proper_frames_that_face_the_viewers_side(
    layout: Layout, count: int, aspect: float, pinned: int | None
) -> None:
    plan = plan_seats(layout, count, aspect, pinned=pinned)
    for seat in plan.seats:
        turn = seat[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(turn) == pytest.approx(1)
        assert turn[1, 1] > 0.8  # upright
        assert np.dot(turn[:, 2], plan.camera_m - seat[:3, 3]) > 0


@given(
    layout=layouts,
    count=st.integers(2, 9),
    aspect=aspects,
    shoulders_m=st.floats(MIN_SHOULDERS_M, MAX_SHOULDERS_M),
)
def test_no_shoulders_cut_into_those_of_a_neighbour(
    layout: Layout, count: int, aspect: float, shoulders_m: float
) -> None:
    plan = plan_seats(layout, count, aspect, shoulders_m=shoulders_m)
    turn = np.linspace(0, 2 * math.pi, 64)
    # Seen from above shoulders are an ellipse about the seat; the arms' ends lie in its middle.
    half = np.array([shoulders_m / 2, SHOULDER_DEPTH_M])
    rim = np.stack([half[0] * np.cos(turn), 0 * turn, half[1] * np.sin(turn)], axis=-1)
    for first, second in combinations(plan.seats, 2):
        if abs(first[1, 3] - second[1, 3]) > 0.3:
            continue  # another row
        seen = (rim @ first[:3, :3].T + first[:3, 3] - second[:3, 3]) @ second[:3, :3]
        assert (np.square(seen[:, [0, 2]] / half).sum(axis=1) > 1).all()


@pytest.mark.parametrize("shoulders_m", [0.0, -1.0, 40.0])
def test_an_avatar_of_odd_breadth_moves_nobody_out_of_sight(shoulders_m: float) -> None:
    plan = plan_seats("line", 2, 16 / 9, shoulders_m=shoulders_m)
    apart = plan.seats[1][0, 3] - plan.seats[0][0, 3]
    assert MIN_SHOULDERS_M < apart < MAX_SHOULDERS_M + 0.1


def head_px(camera: Camera, seat: Float64Array) -> Rect:
    """Where a head at rest is, chin to hair, without room for its movements."""
    corners = np.array([[-0.095, 0.15, 0.0], [0.095, -0.125, 0.0]]) @ seat[:3, :3].T
    (left, top), (right, bottom) = camera.project(corners + seat[:3, 3])[0].tolist()
    return left, top, right, bottom


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_up_to_sixteen_heads_are_whole_and_free_on_any_picture(
    layout: Layout, size: tuple[int, int]
) -> None:
    for count in range(1, 17):
        for pinned in (None, 0, count - 1):
            plan = plan_seats(layout, count, size[0] / size[1], pinned=pinned)
            camera = plan_camera(plan, ViewState(), *size)
            heads = [head_px(camera, seat) for seat in plan.seats]
            for left, top, right, bottom in heads:
                assert 0 <= left < right <= size[0]
                assert 0 <= top < bottom <= size[1]
            assert not any(common_px(*pair) for pair in combinations(heads, 2))


@pytest.mark.parametrize("size", [(320, 240), (640, 360), (1280, 720), (3840, 2160), (2560, 1080)])
@pytest.mark.parametrize("layout", ["line", "table"])
def test_few_people_are_filmed_as_those_who_talk_are(layout: Layout, size: tuple[int, int]) -> None:
    for count in (1, 2):
        plan = plan_seats(layout, count, size[0] / size[1])
        camera = plan_camera(plan, ViewState(), *size)
        for seat in plan.seats:
            _, top, _, bottom = head_px(camera, seat)
            assert 0.3 < (bottom - top) / size[1] < 0.45
            assert 0.28 < (top + bottom) / 2 / size[1] < 0.42  # the eyes are in the middle


def test_five_people_on_a_wide_picture_are_large_and_in_the_upper_half() -> None:
    for layout in LAYOUTS:
        plan = plan_seats(layout, 5, 16 / 9, shoulders_m=0.375)
        camera = plan_camera(plan, ViewState(), 1280, 720)
        heads = [head_px(camera, seat) for seat in plan.seats]
        assert all(bottom - top > 0.23 * 720 for _, top, _, bottom in heads)
        assert layout == "grid" or all(top + bottom < 720 for _, top, _, bottom in heads)


@pytest.mark.slow
@given(layout=layouts, other=layouts, count=st.integers(1, 9), aspect=aspects, pinned=pins)
def test_people_move_to_another_plan_step_by_step_and_arrive(
    layout: Layout, other: Layout, count: int, aspect: float, pinned: int | None
) -> None:
    plan = plan_seats(layout, count, aspect)
    goal = plan_seats(other, count, aspect, pinned=pinned)
    left_m = math.inf
    for _ in range(60):
        before, plan = plan, plan.nearing(goal, 0.2)
        step = np.subtract([*plan.places_m, plan.camera_m], [*before.places_m, before.camera_m])
        to_go = np.subtract([*plan.places_m, plan.camera_m], [*goal.places_m, goal.camera_m])
        assert np.abs(step).max() <= max(0.26 * np.abs(to_go).max(), 0.002)
        assert np.abs(to_go).max() <= left_m
        left_m = float(np.abs(to_go).max())
        for seat in plan.seats:
            np.testing.assert_allclose(seat[:3, :3] @ seat[:3, :3].T, np.eye(3), atol=1e-9)
    assert plan is goal


@pytest.mark.parametrize("size", [(320, 240), (300, 500), (480, 270), (1280, 720), (3840, 2160)])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_faces_stay_of_a_useful_size_on_any_picture(layout: Layout, size: tuple[int, int]) -> None:
    for count in (1, 2, 3, 5):
        for pinned in (None, 0):
            plan = plan_seats(layout, count, size[0] / size[1], pinned=pinned)
            camera = plan_camera(plan, ViewState(), *size)
            for index, seat in enumerate(plan.seats):
                rect = head_rect_px(camera, seat)
                assert rect is not None
                is_aside = pinned is not None and index != pinned
                least = 0.1 if is_aside else 0.19
                assert rect[3] - rect[1] >= least * min(size)


@given(
    layout=layouts,
    count=counts,
    aspect=aspects,
    pinned=pins,
    yaw=st.floats(-1.5, 1.5),
    pitch=st.floats(-1.5, 1.5),
    zoom=st.floats(0.1, 50),
)
def test_the_camera_never_enters_a_head_and_sees_no_face_from_behind(
    layout: Layout,
    count: int,
    aspect: float,
    pinned: int | None,
    yaw: float,
    pitch: float,
    zoom: float,
) -> None:
    plan = plan_seats(layout, count, aspect, pinned=pinned)
    camera = plan_camera(plan, ViewState(yaw=yaw, pitch=pitch, zoom=zoom), 1280, 720)
    for seat in plan.seats:
        assert np.linalg.norm(camera.centre_m - seat[:3, 3]) >= NEAREST_M - 1e-9
    seen = camera.centre_m - plan.target_m
    assert abs(math.degrees(math.atan2(seen[0], seen[2]))) <= 45.1
    assert -26.1 <= math.degrees(math.asin(seen[1] / np.linalg.norm(seen))) <= 35.1


def test_coming_closer_ends_softly() -> None:
    plan = plan_seats("line", 1, 16 / 9)
    ways = [
        float(np.linalg.norm(plan_camera(plan, ViewState(zoom=zoom), 960, 540).centre_m))
        for zoom in 1.1 ** np.arange(40)
    ]
    steps = -np.diff(ways)
    assert (steps >= -1e-12).all()
    assert (np.diff(steps[:25]) <= 1e-12).all()
    assert ways[-1] < NEAREST_M + 0.1


def test_people_at_the_table_are_turned_to_each_other_and_seen_from_above() -> None:
    plan = plan_seats("table", 5, 16 / 9)
    assert plan.seats[0][0, 2] > 0.3  # whoever sits on the left looks to the right
    assert plan.seats[-1][0, 2] < -0.3
    assert plan.camera_m[1] > plan.target_m[1] + 0.1
    assert plan.seats[0][2, 3] > plan.seats[2][2, 3]  # the sides are nearer


def test_nobody_is_seated_and_seen_all_the_same() -> None:
    for layout in LAYOUTS:
        plan = plan_seats(layout, 0, 16 / 9)
        assert plan.seats == ()
        plan_camera(plan, ViewState(), 320, 180)


@pytest.mark.parametrize("aspect", [0.0, -1.0, math.nan, math.inf])
def test_a_picture_without_a_shape_is_refused(aspect: float) -> None:
    with pytest.raises(ValueError, match="cannot be seated"):
        plan_seats("line", 2, aspect)


spans = st.builds(
    ViewSpan, st.floats(-90, -1), st.floats(1, 90), st.floats(-60, -1), st.floats(1, 60)
)


@given(layout=layouts, span=spans, yaw=st.floats(-2, 2), pitch=st.floats(-2, 2))
def test_nobody_is_turned_further_than_their_avatar_was_seen(
    layout: Layout, span: ViewSpan, yaw: float, pitch: float
) -> None:
    plan = plan_seats(layout, 3, 16 / 9)
    limits = orbit_limits(plan, (USUAL_SPAN, span, USUAL_SPAN))

    def seen(view: ViewState) -> tuple[float, float]:
        camera = plan_camera(plan, view, 640, 360, limits)
        x, y, z = view_direction(plan.seats[1].astype(np.float32), camera.centre_m)
        return math.degrees(math.atan2(x, z)), math.degrees(math.asin(y))

    home = seen(ViewState())
    for view in (ViewState(yaw=yaw), ViewState(pitch=pitch)):
        turned = seen(view)
        for k, (low, high) in enumerate(
            ((span.min_yaw, span.max_yaw), (span.min_pitch, span.max_pitch))
        ):
            assert min(low, home[k]) - 2 <= turned[k] <= max(high, home[k]) + 2


def test_a_view_turns_as_far_as_all_avatars_allow() -> None:
    plan = plan_seats("line", 1, 16 / 9)
    usual, narrow = (
        orbit_limits(plan, (span,)) for span in (USUAL_SPAN, ViewSpan(-40, 60, -30, 36))
    )
    assert math.degrees(usual.max_yaw) == pytest.approx(60 - KEPT_DEGREES, abs=1.01)
    assert math.degrees(narrow.max_yaw) == pytest.approx(60 - KEPT_DEGREES, abs=1.01)
    assert math.degrees(narrow.min_yaw) == pytest.approx(KEPT_DEGREES - 40, abs=1.01)
    assert narrow.max_pitch == usual.max_pitch


@pytest.mark.parametrize("count", [2, 4, 5, 7])
@pytest.mark.parametrize("right", [0.0, 0.3, 0.42])
@pytest.mark.parametrize("aspect", [16 / 9, 4 / 3])
def test_shoulders_of_who_is_pinned_end_before_the_strip(
    count: int, right: float, aspect: float
) -> None:
    shoulders_m = 0.36
    free = FreeShares(right=right, bottom=0.1)
    plan = plan_seats("line", count, aspect, pinned=0, free=free, shoulders_m=shoulders_m)
    camera, _ = picture(plan, aspect)
    half_m = shoulders_m / 2 * camera.rotation[0]
    (pinned, *others) = (seat[:3, 3] for seat in plan.seats)
    (shoulder, *strip), _ = camera.project(
        np.array([pinned + half_m, *(at - half_m for at in others)])
    )
    assert all(shoulder[0] <= edge[0] + 1 for edge in strip)
