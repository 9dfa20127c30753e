"""What of each head can be seen: size, screen edge, near plane, other heads, two eyes."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.render.scene import clip_from_head
from pica_client.schedule.visibility import PlacedHead, Sight, look, merge_eyes
from pica_core.camera import Camera, look_at

pytestmark = pytest.mark.unit

SIZE = (640, 360)
RADII = np.array([0.10, 0.15, 0.12])
Named = tuple[str, PlacedHead]


def camera(x_m: float = 0.0, z_m: float = 1.0, target_z_m: float = 0.0) -> Camera:
    return look_at(
        centre_m=(x_m, 0.0, z_m),
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
    matrix = clip_from_head(eye or camera(), world_from_head)
    return slot, PlacedHead(matrix, -RADII, RADII)


def see(*heads: Named) -> dict[str, Sight]:
    sights = look([head for _, head in heads], SIZE)
    return dict(zip((slot for slot, _ in heads), sights, strict=True))


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


@pytest.mark.parametrize("place", [(0, 0, 0), (0.2, 0.1, -0.4), (-0.3, 0.05, -2.0)])
def test_a_whole_head_covers_the_pixels_that_rays_hit(place: tuple[float, float, float]) -> None:
    hit = pixels_hit(place, camera())
    sight = see(head("ada", *place))["ada"]
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
    assert (ben.is_visible, ben.hidden_ratio) == (True, 0)


def test_who_looks_from_behind_or_from_below_sees_as_much() -> None:
    ahead = see(head("ada"))["ada"]
    behind = camera(z_m=-1.0)
    seen = see(head("ada", eye=behind))["ada"]
    assert seen.visible_px == pytest.approx(ahead.visible_px, rel=1e-3)
    below = look_at(
        centre_m=(0, -1, 0.01),
        target_m=(0, 0, 0),
        vertical_fov=math.radians(40),
        width=SIZE[0],
        height=SIZE[1],
    )
    seen = see(head("ada", eye=below))["ada"]
    assert seen.is_visible
    assert seen.visible_px == pytest.approx(pixels_hit((0, 0, 0), below).sum(), rel=0.02)


def test_a_head_right_behind_another_cannot_be_seen() -> None:
    sights = see(head("far", z=-0.6), head("near", z=0.2))
    assert not sights["far"].is_visible
    assert sights["far"].hidden_ratio == 1
    assert sights["near"].hidden_ratio == 0


def test_of_a_head_half_behind_another_about_half_is_hidden() -> None:
    eye = camera()
    near, far = (0.0, 0.0, 0.3), (0.14, 0.0, -0.3)
    both = pixels_hit(near, eye) & pixels_hit(far, eye)
    share = both.sum() / pixels_hit(far, eye).sum()
    sight = see(head("near", *near), head("far", *far))["far"]
    assert 0.2 < share < 0.8
    assert sight.hidden_ratio == pytest.approx(share, abs=0.12)
    assert sight.hidden_ratio <= share + 0.02  # rather too little hidden than too much


def test_of_five_overlapping_heads_the_nearest_alone_is_whole() -> None:
    heads = [head(f"h{i}", x=0.03 * i, z=-0.25 * i) for i in range(5)]
    sights = see(*heads)
    hidden = [sights[f"h{i}"].hidden_ratio for i in range(5)]
    assert hidden[0] == 0
    assert min(hidden[1:]) > 0.5
    total = sum(sight.visible_px for sight in sights.values())
    assert total <= 1.3 * sights["h0"].visible_px


def test_a_one_pixel_avatar_is_seen_and_a_smaller_one_is_not() -> None:
    tall = 2 * math.tan(math.radians(20)) / SIZE[1]  # metres of a pixel at one metre
    depth = 0.3 / (2 * tall)
    sight = see(head("dot", z=1 - depth))["dot"]
    assert sight.is_visible
    assert 0.5 < sight.visible_px < 4
    assert not see(head("dust", z=1 - 12 * depth))["dust"].is_visible


def test_a_matrix_that_is_not_finite_hides_its_head_alone() -> None:
    broken = PlacedHead(np.full((4, 4), np.nan, np.float32), -RADII, RADII)
    flat = PlacedHead(head("flat")[1].clip_from_head, RADII, RADII)
    sights = see(("bad", broken), ("flat", flat), head("good"))
    assert [sights[slot].is_visible for slot in ("bad", "flat", "good")] == [False, False, True]


def test_nobody_there_is_nothing_seen() -> None:
    assert look([], SIZE) == []


def test_two_eyes_see_what_either_sees_and_draw_it_twice() -> None:
    eyes = [camera(-0.03), camera(0.03)]
    sights = [see(head("mid", eye=e), head("side", x=0.75, eye=e)) for e in eyes]
    mid, side = merge_eyes([list(each.values()) for each in sights])
    assert mid.visible_px == sum(sight["mid"].visible_px for sight in sights)
    assert mid.head_px == max(sight["mid"].head_px for sight in sights)
    assert mid.num_views == 2
    assert [sight["side"].is_visible for sight in sights] == [False, True]
    assert (side.is_visible, side.num_views) == (True, 1)


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
        assert 0 <= sight.hidden_ratio <= 1
        assert sight.is_visible == (sight.visible_px > 0)
