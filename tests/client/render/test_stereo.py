"""Two eyes: where they are, what each sees, and that no text crosses from one into the other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.render.seats import LAYOUTS, Layout, plan_seats
from pica_client.render.views import ViewState, plan_camera, stereo_cameras
from pica_core.camera import Camera

pytestmark = pytest.mark.unit

EYE = (640, 720)
DISTANCE_M = 0.063


def middle() -> tuple[Camera, float]:
    plan = plan_seats("line", 5, EYE[0] / EYE[1])
    camera = plan_camera(plan, ViewState(yaw=0.3, pitch=0.2), *EYE)
    return camera, float(np.linalg.norm(plan.target_m - camera.centre_m))


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
    camera, screen_m = middle()
    left, right = stereo_cameras(camera, DISTANCE_M, screen_m)
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
