"""Poses, views, both eyes, and the part of the screen that a head may cover."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.render.scene import (
    FAR_M,
    NEAR_M,
    Placement,
    head_matrix,
    head_rect_px,
    pick_head,
    rotation_matrix,
    screen_rects,
    view_direction,
)
from pica_client.render.seats import LAYOUTS, Layout, plan_seats
from pica_client.render.views import (
    MAX_ZOOM,
    MIN_ZOOM,
    OrbitLimits,
    ViewState,
    plan_camera,
    stereo_cameras,
)
from pica_core.avatar.bust import box_corners

pytestmark = pytest.mark.unit

WIDE = 16 / 9
LIMITS = OrbitLimits()
HOME = plan_camera(plan_seats("line", 1, WIDE), ViewState(), 960, 540)


BOX_LOW, BOX_HIGH = (-0.1, -0.15, -0.1), (0.1, 0.15, 0.1)
small = st.floats(-3, 3, allow_nan=False)


@given(x=small, y=small, z=small)
def test_a_rotation_vector_turns_by_its_length_about_itself(x: float, y: float, z: float) -> None:
    matrix = rotation_matrix([x, y, z])
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(matrix @ [x, y, z], [x, y, z], atol=1e-10)
    angle = math.hypot(x, y, z)
    assert np.trace(matrix) == pytest.approx(1 + 2 * math.cos(angle), abs=1e-10)


def test_a_head_moves_along_the_axes_of_its_seat() -> None:
    plan = plan_seats("line", 2, WIDE)
    seat = plan.seats[0]
    moved = head_matrix(seat, [0, 0, 0], [0, 0, 0.3])[:3, 3]
    nearer = np.linalg.norm(plan.camera_m - seat[:3, 3]) - np.linalg.norm(plan.camera_m - moved)
    assert nearer == pytest.approx(0.3, abs=1e-6)


def test_a_head_turned_to_its_left_sees_the_viewer_on_its_right() -> None:
    matrix = head_matrix(np.eye(4), [0, math.radians(30), 0], [0, 0, 0])
    direction = view_direction(matrix, [0, 0, 1])
    np.testing.assert_allclose(direction, [-0.5, 0, math.cos(math.radians(30))], atol=1e-6)
    assert np.linalg.norm(direction) == pytest.approx(1)


def test_from_inside_the_head_the_view_is_straight_ahead() -> None:
    direction = view_direction(np.eye(4, dtype=np.float32), [0, 0, 0])
    np.testing.assert_array_equal(direction, [0, 0, 1])


@given(yaw=st.floats(-1e4, 1e4), pitch=st.floats(-1e4, 1e4))
def test_no_drag_turns_the_view_over(yaw: float, pitch: float) -> None:
    view = LIMITS.clamped(ViewState().orbited(yaw, pitch))
    assert LIMITS.min_pitch <= view.pitch <= LIMITS.max_pitch
    assert LIMITS.min_yaw <= view.yaw <= LIMITS.max_yaw


@given(steps=st.floats(allow_nan=False))
def test_zoom_keeps_its_limits(steps: float) -> None:
    assert MIN_ZOOM <= ViewState().zoomed(steps).zoom <= MAX_ZOOM


def test_dragging_to_the_right_turns_the_scene_with_the_hand() -> None:
    turned = ViewState().orbited(100, 0)
    camera = plan_camera(plan_seats("line", 1, WIDE), turned, 960, 540)
    nose, _ = camera.project([0, 0, 0.1])
    middle, _ = camera.project([0, 0, 0])
    assert nose[0] > middle[0]


def box_rect(matrix: np.ndarray) -> tuple[float, ...] | None:
    (rect,) = screen_rects(matrix[None], box_corners(BOX_LOW, BOX_HIGH)[None])
    return rect


def test_a_box_in_view_covers_the_rectangle_of_its_corners() -> None:
    rect = box_rect(HOME.clip_from_world(NEAR_M, FAR_M))
    assert rect is not None
    left, bottom, right, top = rect
    pixels, _ = HOME.project([[-0.1, 0.15, 0.1], [0.1, -0.15, 0.1]])
    np.testing.assert_allclose(
        [left, top, right, bottom],
        [
            pixels[0, 0] / 480 - 1,
            1 - pixels[0, 1] / 270,
            pixels[1, 0] / 480 - 1,
            1 - pixels[1, 1] / 270,
        ],
        atol=1e-4,
    )


@pytest.mark.parametrize("offset", [(5.0, 0, 0), (0, 5.0, 0), (0, 0, 5.0)])
def test_a_box_out_of_view_covers_nothing(offset: tuple[float, float, float]) -> None:
    world_from_head = head_matrix(np.eye(4), [0, 0, 0], offset)
    assert box_rect(np.matmul(HOME.clip_from_world(NEAR_M, FAR_M), world_from_head)) is None


def test_a_box_around_the_camera_may_cover_everything() -> None:
    world_from_head = head_matrix(np.eye(4), [0, 0, 0], HOME.centre_m)
    rect = box_rect(np.matmul(HOME.clip_from_world(NEAR_M, FAR_M), world_from_head))
    assert rect == (-1, -1, 1, 1)


def test_a_click_finds_the_head_under_it_and_the_nearer_of_two() -> None:
    plan = plan_seats("line", 2, WIDE)
    camera = plan_camera(plan, ViewState(), 960, 540)
    left, right = (
        Placement(slot=name, world_from_head=seat.astype(np.float32))
        for name, seat in zip(("left", "right"), plan.seats, strict=True)
    )
    behind = Placement(
        slot="behind", world_from_head=head_matrix(plan.seats[0], [0, 0, 0], [0, 0, -0.5])
    )
    rect = head_rect_px(camera, left.world_from_head)
    assert rect is not None
    x, y = (rect[0] + rect[2]) / 2, (rect[1] + rect[3]) / 2
    assert pick_head([right, behind, left], camera, x, y) == "left"
    assert pick_head([left, right], camera, 960 - x, y) == "right"
    assert pick_head([left, right], camera, 5, 5) is None


def test_a_head_behind_the_camera_covers_nothing_and_cannot_be_clicked() -> None:
    behind = head_matrix(np.eye(4), [0, 0, 0], HOME.centre_m + np.array([0, 0, NEAR_M]))
    assert head_rect_px(HOME, behind) is None
    placement = Placement(slot="p", world_from_head=behind)
    assert pick_head([placement], HOME, 480, 270) is None


EYE = (640, 720)


@given(
    layout=st.sampled_from(LAYOUTS),
    yaw=st.floats(-3, 3),
    pitch=st.floats(-1.3, 1.3),
    distance_m=st.floats(0, 0.2),
)
def test_the_eyes_are_their_distance_apart_and_look_the_same_way(
    layout: Layout, yaw: float, pitch: float, distance_m: float
) -> None:
    camera = plan_camera(plan_seats(layout, 5, 0.9), ViewState(yaw=yaw, pitch=pitch), *EYE)
    left, right = stereo_cameras(camera, distance_m, 1.3)
    apart = right.centre_m - left.centre_m
    np.testing.assert_allclose(apart, distance_m * camera.rotation[0], atol=1e-9)
    np.testing.assert_allclose((left.centre_m + right.centre_m) / 2, camera.centre_m, atol=1e-9)
    np.testing.assert_array_equal(left.rotation, right.rotation)


def test_what_is_as_far_as_the_screen_is_at_one_place_in_both_eyes() -> None:
    plan = plan_seats("line", 5, EYE[0] / EYE[1])
    camera = plan_camera(plan, ViewState(yaw=0.3, pitch=0.2), *EYE)
    screen_m = float(np.linalg.norm(plan.target_m - camera.centre_m))
    left, right = stereo_cameras(camera, 0.063, screen_m)
    forward = camera.rotation[2]
    for far_m, sign in ((screen_m, 0), (0.7 * screen_m, 1), (2 * screen_m, -1)):
        for up in (-0.2, 0.0, 0.3):
            point = camera.centre_m + far_m * forward + up * camera.rotation[1]
            (x_left, y_left), _ = left.project(point)
            (x_right, y_right), _ = right.project(point)
            assert y_left == pytest.approx(y_right, abs=1e-6)
            # What is nearer is further right for the left eye.
            difference = x_left - x_right
            assert difference == pytest.approx(0, abs=1e-6) if not sign else difference * sign > 1
