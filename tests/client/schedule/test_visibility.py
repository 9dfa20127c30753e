"""What of each head can be seen: size, screen edge, near plane, other heads, two eyes."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.render.scene import FAR_M, NEAR_M
from pica_client.schedule.visibility import NOTHING, Sight, look
from pica_core.camera import Camera, look_at
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit

SIZE = (640, 360)
RADII = np.array([0.10, 0.15, 0.12])
Named = tuple[str, FloatArray]


def camera(x_m: float = 0.0, z_m: float = 1.0, target_z_m: float = 0.0, y_m: float = 0.0) -> Camera:
    return look_at(
        centre_m=(x_m, y_m, z_m),
        target_m=(x_m, 0.0, target_z_m),
        vertical_fov=math.radians(40),
        width=SIZE[0],
        height=SIZE[1],
    )


def head(
    slot: str, x: float = 0.0, y: float = 0.0, z: float = 0.0, eye: Camera | None = None
) -> Named:
    world_from_head = np.eye(4, dtype=np.float32)
    world_from_head[:3, 3] = x, y, z
    return slot, np.matmul((eye or camera()).clip_from_world(NEAR_M, FAR_M), world_from_head)


def see(*heads: Named) -> dict[str, Sight]:
    boxes = [RADII] * len(heads)
    sights = look([matrix for _, matrix in heads], np.negative(boxes), boxes, SIZE)
    return dict(zip((slot for slot, _ in heads), sights, strict=True))


def hidden_share(others: list[Named], hidden: Named) -> float:
    """Which part of what would be seen of a head others hide."""
    seen = see(*others, hidden)[hidden[0]]
    return 1 - seen.visible_px / see(hidden)[hidden[0]].visible_px


def pixels_hit(centre: npt.ArrayLike, eye: Camera) -> npt.NDArray[np.bool_]:
    """Which pixels' rays hit the ellipsoid: the judge of the outline."""
    columns, rows = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    k = eye.intrinsics
    rays = np.stack(
        [(columns - k[0, 2]) / k[0, 0], (rows - k[1, 2]) / k[1, 1], np.ones_like(rows)], axis=-1
    )
    rays = rays @ eye.rotation / RADII
    start = (eye.centre_m - np.asarray(centre)) / RADII
    a = (rays**2).sum(-1)
    b = rays @ start
    c = (start**2).sum() - 1
    hit: npt.NDArray[np.bool_] = (b < 0) & (b * b >= a * c)
    return hit


@pytest.mark.parametrize(
    ("place", "eye"),
    [
        ((0, 0, 0), camera()),
        ((0.2, 0.1, -0.4), camera()),
        ((-0.3, 0.05, -2.0), camera()),
        ((0, 0, 0), camera(z_m=-1.0)),
        ((0, 0, 0), camera(y_m=-1.0, z_m=0.01)),
    ],
)
def test_a_whole_head_covers_the_pixels_that_rays_hit(
    place: tuple[float, float, float], eye: Camera
) -> None:
    hit = pixels_hit(place, eye)
    sight = see(head("ada", *place, eye=eye))["ada"]
    assert sight.visible_px == pytest.approx(hit.sum(), rel=0.02)
    rows = np.flatnonzero(hit.any(axis=1))
    assert sight.head_px == pytest.approx(len(rows), abs=1.5)


@pytest.mark.parametrize("x", [0.45, 0.6, 0.66])
def test_a_head_at_the_edge_covers_what_is_on_the_screen(x: float) -> None:
    hit = pixels_hit((x, 0, 0), camera())
    sight = see(head("ada", x))["ada"]
    assert sight.visible_px == pytest.approx(hit.sum(), rel=0.12, abs=400)
    assert sight.head_px == pytest.approx(see(head("ada"))["ada"].head_px, rel=0.12)


@pytest.mark.parametrize("place", [(3, 0, 0), (0, 2, 0), (0, 0, 1.5), (0, 0, 30)])
def test_outside_the_picture_or_behind_nothing_is_seen(place: tuple[float, float, float]) -> None:
    sight = see(head("ada", *place))["ada"]
    assert not sight.is_visible
    assert sight.visible_px == 0


def test_a_head_through_the_near_plane_fills_the_screen_and_hides_nobody() -> None:
    sights = see(head("ada", z=0.95), head("ben", z=-1))
    ada, ben = sights["ada"], sights["ben"]
    assert ada.is_visible
    assert (ada.visible_px, ada.head_px) == (SIZE[0] * SIZE[1], SIZE[1])
    assert ben == see(head("ben", z=-1))["ben"]


def test_a_head_right_behind_another_cannot_be_seen() -> None:
    sights = see(head("far", z=-0.6), head("near", z=0.2))
    assert sights == {"far": NOTHING, "near": see(head("near", z=0.2))["near"]}


def test_of_a_head_half_behind_another_about_half_is_hidden() -> None:
    eye = camera()
    near, far = (0.0, 0.0, 0.3), (0.14, 0.0, -0.3)
    both = pixels_hit(near, eye) & pixels_hit(far, eye)
    share = both.sum() / pixels_hit(far, eye).sum()
    hidden = hidden_share([head("near", *near)], head("far", *far))
    assert 0.2 < share < 0.8
    assert hidden == pytest.approx(share, abs=0.12)
    assert hidden <= share + 0.02  # rather too little hidden than too much


def test_a_one_pixel_avatar_is_seen_and_a_smaller_one_is_not() -> None:
    tall = 2 * math.tan(math.radians(20)) / SIZE[1]  # metres of a pixel at one metre
    depth = 0.3 / (2 * tall)
    sight = see(head("dot", z=1 - depth))["dot"]
    assert sight.is_visible
    assert 0.5 < sight.visible_px < 4
    assert not see(head("dust", z=1 - 12 * depth))["dust"].is_visible


def test_a_matrix_that_is_not_finite_hides_its_head_alone() -> None:
    broken = np.full((4, 4), np.nan, np.float32)
    sights = see(("bad", broken), head("good"))
    assert [sights[slot].is_visible for slot in ("bad", "good")] == [False, True]


def test_two_eyes_see_what_either_sees_and_draw_it_twice() -> None:
    eyes = [camera(-0.03), camera(0.03)]
    left, right = (see(head("mid", eye=e), head("side", x=0.75, eye=e)) for e in eyes)
    mid = left["mid"].with_eye(right["mid"])
    assert mid.visible_px == left["mid"].visible_px + right["mid"].visible_px
    assert mid.head_px == max(left["mid"].head_px, right["mid"].head_px)
    assert mid.num_views == 2
    assert left["side"].with_eye(right["side"]) == right["side"] != NOTHING


places = st.tuples(st.floats(-1.5, 1.5), st.floats(-1, 1), st.floats(-6, 2), st.integers(0, 1000))


@given(st.lists(places, min_size=1, max_size=6), st.randoms(use_true_random=False))
def test_what_is_seen_does_not_depend_on_the_order_and_stays_in_bounds(
    chosen: list[tuple[float, float, float, int]], random: object
) -> None:
    heads = [head(f"h{i}", x, y, z) for i, (x, y, z, _) in enumerate(chosen)]
    shuffled = list(heads)
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    sights = see(*heads)
    assert sights == see(*shuffled)
    for sight in sights.values():
        assert 0 <= sight.visible_px <= SIZE[0] * SIZE[1] * 1.3
        assert sight.is_visible == (sight.visible_px > 0)
