"""The page seats people as the viewer does, and sees them from there."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.page import Page
from pica_client.render.scene import FAR_M, NEAR_M, head_matrix, view_direction
from pica_client.render.seats import LAYOUTS, FreeShares, plan_seats
from pica_client.render.views import ViewState, orbit_limits, plan_camera
from pica_core.avatar.manifest import ViewSpan

pytestmark = pytest.mark.unit
PLAY = "../../../tests/web/play"
SPAN = ViewSpan(-60.0, 55.0, -28.0, 33.0)
SHARES = st.floats(0, 0.4)
OPTIONS = st.fixed_dictionaries(
    {"bottom": SHARES, "pinned": st.integers(-1, 9), "shoulders_m": st.floats(0.1, 0.7)}
)
PLANS = st.tuples(st.sampled_from(LAYOUTS), OPTIONS)


@settings(max_examples=60)
@given(
    plans=st.tuples(PLANS, PLANS),
    count=st.integers(1, 9),
    size=st.tuples(st.integers(200, 3840), st.integers(200, 2160)),
    share=st.floats(0, 1),
    orbit=st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.1, 20)),
)
def test_seats_and_cameras_are_those_of_the_viewer(
    page: Page, plans: Any, count: int, size: Any, share: float, orbit: Any
) -> None:
    aspect = size[0] / size[1]
    start, goal = (
        plan_seats(
            layout,
            count,
            aspect,
            pinned=options["pinned"],
            free=FreeShares(bottom=options["bottom"]),
            shoulders_m=options["shoulders_m"],
        )
        for layout, options in plans
    )
    plan = start.nearing(goal, share)
    limits = orbit_limits(plan, (SPAN,) * count)
    view = dict(zip(("yaw", "pitch", "zoom"), orbit, strict=True))
    camera = plan_camera(plan, ViewState(**view), *size, limits)
    sent = [
        [layout, count, aspect, *(options[key] for key in ("bottom", "pinned", "shoulders_m"))]
        for layout, options in plans
    ]
    spans = [[SPAN.min_yaw, SPAN.max_yaw, SPAN.min_pitch, SPAN.max_pitch]] * count
    found = page.call(PLAY, "seat", *sent, share, view, *size, spans)
    expected = {
        "seats": np.ravel(plan.seats),
        "camera": plan.camera_m,
        "target": plan.target_m,
        "limits": [limits.min_yaw, limits.max_yaw, limits.min_pitch, limits.max_pitch],
        "clip": np.ravel(camera.clip_from_world(NEAR_M, FAR_M)),
        "centre": camera.centre_m,
    }
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-5, atol=1e-6, err_msg=name)


def test_heads_stand_and_look_as_in_the_viewer(page: Page) -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        seat = plan_seats("table", 3, 1.5).seats[int(rng.integers(3))]
        rotation, moved, centre = rng.normal(0, 0.4, (3, 3))
        matrix = head_matrix(seat, rotation, moved)
        found = page.call(PLAY, "pose", seat.ravel(), rotation, moved, centre)
        np.testing.assert_allclose(found["matrix"], matrix.ravel(), atol=1e-6)
        np.testing.assert_allclose(found["view"], view_direction(matrix, centre), atol=1e-5)
