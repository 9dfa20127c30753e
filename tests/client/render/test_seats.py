"""Layouts: nobody sits in somebody else, everybody is in the picture, with room for their names."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.render.scene import NEAR_M, Rect, head_rect_px, overlap
from pica_client.render.seats import (
    LAYOUTS,
    SEAT_SPACING_M,
    FreeShares,
    Layout,
    SeatPlan,
    ViewState,
    plan_camera,
    plan_seats,
)
from pica_core.camera import Camera

pytestmark = pytest.mark.unit

WIDTH = 1280
LABEL_PX_OF_HEIGHT = 0.055
"""A name of one line, as part of the picture's height."""
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
def test_everybody_is_in_the_picture_with_room_for_a_name(
    layout: Layout, count: int, aspect: float, pinned: int | None
) -> None:
    camera, rects = picture(plan_seats(layout, count, aspect, pinned=pinned), aspect)
    assert len(rects) == count
    for left, top, right, bottom in rects:
        assert -0.5 <= left < right <= camera.width + 0.5
        assert -0.5 <= top < bottom
        assert bottom + LABEL_PX_OF_HEIGHT * camera.height <= camera.height + 0.5


@given(layout=layouts, count=st.integers(1, 16), aspect=aspects, pinned=pins)
def test_no_two_heads_are_in_the_same_place(
    layout: Layout, count: int, aspect: float, pinned: int | None
) -> None:
    plan = plan_seats(layout, count, aspect, pinned=pinned)
    for first, second in combinations(plan.seats, 2):
        assert np.linalg.norm(first[:3, 3] - second[:3, 3]) > 0.2


@given(layout=layouts, count=counts, aspect=aspects, pinned=pins)
def test_no_head_hides_another_or_its_name(
    layout: Layout, count: int, aspect: float, pinned: int | None
) -> None:
    camera, rects = picture(plan_seats(layout, count, aspect, pinned=pinned), aspect)
    label = LABEL_PX_OF_HEIGHT * camera.height
    for first, second in combinations(rects, 2):
        # Room for movement may be shared a little; the heads themselves are not so wide.
        assert not overlap(shrunk(first), shrunk(second))
        for upper, lower in ((first, second), (second, first)):
            name = (upper[0], upper[3], upper[2], upper[3] + label)
            assert not overlap(shrunk(name), shrunk(lower))


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


@given(layout=layouts, count=st.integers(2, 5), aspect=st.floats(1.2, 2.4), data=st.data())
def test_whoever_is_pinned_is_much_larger_than_the_others(
    layout: Layout, count: int, aspect: float, data: st.DataObject
) -> None:
    pinned = data.draw(st.integers(0, count - 1))
    _, rects = picture(plan_seats(layout, count, aspect, pinned=pinned), aspect)
    heights = [bottom - top for _, top, _, bottom in rects]
    assert all(
        heights[pinned] > 1.8 * height for index, height in enumerate(heights) if index != pinned
    )


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


def test_a_line_is_the_papers_row_a_quarter_of_a_metre_apart() -> None:
    plan = plan_seats("line", 5, 16 / 9)
    places = np.array([seat[:3, 3] for seat in plan.seats])
    np.testing.assert_allclose(np.diff(places[:, 0]), SEAT_SPACING_M)
    np.testing.assert_allclose(places[:, 1:], 0)
    for seat in plan.seats:
        np.testing.assert_allclose(seat[:3, :3], np.eye(3), atol=1e-12)


def test_people_at_the_table_are_turned_to_each_other_and_seen_from_above() -> None:
    plan = plan_seats("table", 5, 16 / 9)
    assert plan.seats[0][0, 2] > 0.3  # whoever sits on the left looks to the right
    assert plan.seats[-1][0, 2] < -0.3
    assert plan.camera_m[1] > plan.target_m[1] + 0.1
    assert plan.seats[0][2, 3] > plan.seats[2][2, 3]  # the sides are nearer


def test_a_grid_of_five_has_two_rows() -> None:
    plan = plan_seats("grid", 5, 16 / 9)
    heights = {round(float(seat[1, 3]), 6) for seat in plan.seats}
    assert len(heights) == 2


def test_nobody_is_seated_and_seen_all_the_same() -> None:
    for layout in LAYOUTS:
        plan = plan_seats(layout, 0, 16 / 9)
        assert plan.seats == ()
        plan_camera(plan, ViewState(), 320, 180)


def test_a_pin_on_nobody_changes_nothing() -> None:
    plain, pinned = plan_seats("arc", 3, 1.5), plan_seats("arc", 3, 1.5, pinned=7)
    np.testing.assert_array_equal(plain.camera_m, pinned.camera_m)


def test_two_plans_of_the_same_people_are_the_same() -> None:
    first, second = plan_seats("grid", 5, 1.5), plan_seats("grid", 5, 1.5)
    np.testing.assert_array_equal(np.array(first.seats), np.array(second.seats))


@pytest.mark.parametrize("aspect", [0.0, -1.0, math.nan, math.inf])
def test_a_picture_without_a_shape_is_refused(aspect: float) -> None:
    with pytest.raises(ValueError, match="cannot be seated"):
        plan_seats("line", 2, aspect)


@pytest.mark.parametrize("share", [-0.1, 0.6, math.nan])
def test_more_than_half_the_picture_cannot_be_kept_free(share: float) -> None:
    with pytest.raises(ValueError, match="can be kept free"):
        FreeShares(top=share)


@given(
    layout=layouts,
    count=counts,
    yaw=st.floats(-7, 7),
    pitch=st.floats(-7, 7),
    zoom=st.floats(0.25, 12),
)
def test_any_view_is_a_camera(
    layout: Layout, count: int, yaw: float, pitch: float, zoom: float
) -> None:
    plan = plan_seats(layout, count, 16 / 9)
    camera = plan_camera(plan, ViewState(yaw=yaw, pitch=pitch, zoom=zoom), 1280, 720)
    assert np.isfinite(camera.rotation).all()
    away = float(np.linalg.norm(camera.centre_m - plan.target_m))
    assert away == pytest.approx(float(np.linalg.norm(plan.camera_m - plan.target_m)) / zoom)
    assert away > NEAR_M
