"""Names stand on chests: never over a face, never wider than their seat."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pica_client.render.scene import Rect, common_px, head_matrix
from pica_client.render.seats import LAYOUTS, Layout, plan_seats
from pica_client.render.views import ViewState, plan_camera
from pica_client.ui.call_surface import FACE_HIGH_M, FACE_LOW_M, HALF_WIDTH_M, place_labels
from pica_core.camera import Camera
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit

LEAST_PX = (36.0, 17.0)
SIZES = [(320, 240), (300, 500), (480, 270), (1280, 720), (3840, 2160)]


def seated(
    layout: Layout, count: int, size: tuple[int, int], pinned: int | None, view: ViewState
) -> tuple[list[FloatArray], Camera]:
    plan = plan_seats(layout, count, size[0] / size[1], pinned=pinned)
    heads = [head_matrix(seat, [0, 0, 0], [0, 0, 0]) for seat in plan.seats]
    return heads, plan_camera(plan, view, *size)


def face_px(head: FloatArray, camera: Camera) -> Rect | None:
    corners = np.array([FACE_LOW_M, FACE_HIGH_M]) @ head[:3, :3].T + head[:3, 3]
    pixels, depth = camera.project(corners)
    if (depth <= 0.02).any():
        return None
    (left, top), (right, bottom) = pixels.min(axis=0), pixels.max(axis=0)
    return float(left), float(top), float(right), float(bottom)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_everybody_has_a_name_on_any_picture(layout: Layout, size: tuple[int, int]) -> None:
    for count in (1, 2, 3, 5):
        for pinned in (None, 0, count - 1):
            heads, camera = seated(layout, count, size, pinned, ViewState())
            assert None not in place_labels(heads, camera, LEAST_PX)


@given(
    layout=st.sampled_from(LAYOUTS),
    count=st.integers(1, 6),
    size=st.sampled_from(SIZES),
    pinned=st.none() | st.integers(0, 5),
    yaw=st.floats(-0.8, 0.8),
    pitch=st.floats(-0.4, 0.5),
    zoom=st.floats(0.4, 12),
)
@example(layout="line", count=1, size=(300, 500), pinned=None, yaw=0, pitch=0, zoom=3)
def test_no_name_covers_a_face_or_another_name_or_leaves_the_picture(
    layout: Layout,
    count: int,
    size: tuple[int, int],
    pinned: int | None,
    yaw: float,
    pitch: float,
    zoom: float,
) -> None:
    view = ViewState(yaw=yaw, pitch=pitch, zoom=zoom)
    heads, camera = seated(layout, count, size, pinned, view)
    rooms = place_labels(heads, camera, LEAST_PX)
    plates = []
    for head, room in zip(heads, rooms, strict=True):
        if room is None:
            continue
        left, top, right, bottom = room
        assert left >= 0
        assert right <= size[0]
        assert bottom <= size[1]
        assert right - left >= LEAST_PX[0] - 1e-6
        assert bottom - top >= LEAST_PX[1] - 1e-6
        depth = float((camera.rotation @ head[:3, 3] + camera.translation_m)[2])
        widest = 2 * HALF_WIDTH_M * camera.intrinsics[1, 1] / max(depth - 0.1, 0.02)
        assert right - left <= max(widest, LEAST_PX[0] + 0.1)
        for other in heads:
            face = face_px(other, camera)
            assert face is None or common_px(room, face) == 0
        plates.append((left, top, right, top + LEAST_PX[1]))
    for first, second in combinations(plates, 2):
        assert common_px(first, second) == 0


def test_who_is_hidden_or_off_the_picture_has_no_name() -> None:
    heads, camera = seated("line", 1, (640, 360), None, ViewState())
    (head,) = heads
    behind = head_matrix(np.eye(4), [0, 0, 0], [0.01, 0, -0.5])
    aside = head_matrix(np.eye(4), [0, 0, 0], [3, 0, 0])
    back = head_matrix(np.eye(4), [0, 0, 0], camera.centre_m + np.array([0, 0, 0.3]))
    rooms = place_labels([behind, head, aside, back], camera, LEAST_PX)
    assert [room is None for room in rooms] == [True, False, True, True]
