"""What the driver remembers of heads, and what it makes of the scheduler's plans."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.decode.decoder import DecodedMaps
from pica_client.decode.pool import DecodeResult
from pica_client.render.scene import Placement, head_matrix, view_direction
from pica_client.schedule.frame_planner import BLEND_S, FramePlanner, SceneHead
from pica_client.schedule.scheduler import Plan, Scheduler
from pica_core.avatar.file import Avatar
from pica_core.camera import Camera, look_at

pytestmark = pytest.mark.unit

SIZE = (960, 540)
AMPLE_S = 10.0
FRAME_S = 1 / 30


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return with_toy_levels(make_toy_avatar())


def camera_at(distance_m: float = 0.8, side_m: float = 0.0, *, away: bool = False) -> Camera:
    return look_at(
        centre_m=(side_m, 0.0, distance_m),
        target_m=(0.0, 0.0, 2 * distance_m if away else 0.0),
        vertical_fov=math.radians(45),
        width=SIZE[0],
        height=SIZE[1],
    )


def head(avatar: Avatar, slot: str = "ada", x_m: float = 0.0, value: float = 0.0) -> SceneHead:
    seat = np.eye(4)
    seat[0, 3] = x_m
    latent = np.full((8, 8, 4), value, np.float32)
    matrix = head_matrix(seat, np.zeros(3), np.zeros(3))
    return SceneHead(slot=slot, avatar=avatar, world_from_head=matrix, latent=latent)


def planned(
    driver: FramePlanner, *heads: SceneHead, camera: Camera | None = None, now: float = 0.0
) -> Plan:
    return driver.plan(heads, [camera or camera_at()], SIZE, AMPLE_S, now)


def decoded(slot: str, level: int, decode_s: float = 1e-3) -> DecodeResult:
    empty: npt.NDArray[np.float32] = np.zeros((level, level, 3), np.float32)
    maps = DecodedMaps(empty, np.zeros((level, level, 4), np.float32), level)
    return DecodeResult(slot, maps, None, started_s=0.0, finished_s=decode_s, level=level)


def test_a_face_that_is_new_is_decoded_and_one_that_stands_still_is_not(avatar: Avatar) -> None:
    driver = FramePlanner(Scheduler())
    first = driver.requests(planned(driver, head(avatar)), 0.0)
    assert [slot for slot, _ in first] == ["ada"]
    assert driver.requests(planned(driver, head(avatar), now=FRAME_S), FRAME_S) == []


def test_a_face_that_moves_is_decoded_anew_with_its_newest_latent(avatar: Avatar) -> None:
    driver = FramePlanner(Scheduler())
    driver.requests(planned(driver, head(avatar)), 0.0)
    moved = head(avatar, value=1.0)
    ((_, request),) = driver.requests(planned(driver, moved, now=FRAME_S), FRAME_S)
    assert request.parts == "both"
    assert request.latent is moved.latent


def test_a_view_that_turns_past_a_still_face_makes_its_expression_map_alone(
    avatar: Avatar,
) -> None:
    driver = FramePlanner(Scheduler())
    still = head(avatar)
    driver.requests(planned(driver, still), 0.0)
    plan = planned(driver, still, camera=camera_at(side_m=0.6), now=FRAME_S)
    ((_, request),) = driver.requests(plan, FRAME_S)
    assert request.parts == "expression"
    assert request.latent is still.latent
    assert request.view_direction[0] > 0.3


def test_behind_the_viewer_nothing_is_decoded_and_the_stream_is_given_up_later(
    avatar: Avatar,
) -> None:
    driver = FramePlanner(Scheduler())
    away = camera_at(away=True)
    layers = []
    for frame in range(90):
        now = frame * FRAME_S
        plan = planned(driver, head(avatar, value=float(frame)), camera=away, now=now)
        assert driver.requests(plan, now) == []
        layers.append(plan.choices["ada"].wanted_layer)
    assert layers[0] is not None
    assert layers[-1] is None


def test_who_comes_back_into_view_is_decoded_in_the_very_next_frame(avatar: Avatar) -> None:
    driver = FramePlanner(Scheduler())
    for frame in range(60):
        planned(driver, head(avatar), camera=camera_at(away=True), now=frame * FRAME_S)
    plan = planned(driver, head(avatar), now=2.0)
    assert len(driver.requests(plan, 2.0)) == 1
    assert plan.choices["ada"].wanted_layer is not None


def test_where_time_is_short_a_far_head_gives_up_more_than_a_near_one(avatar: Avatar) -> None:
    near, far = head(avatar, "near"), head(avatar, "far", x_m=1.0)
    far.world_from_head[2, 3] = -4.0
    free = planned(FramePlanner(Scheduler()), near, far)
    budget_s = free.floor_s + 0.5 * (free.cost_s - free.floor_s)
    plan = FramePlanner(Scheduler()).plan([near, far], [camera_at()], SIZE, budget_s, 0.0)
    assert plan.limited
    assert plan.choices["far"].level < plan.choices["near"].level


def test_maps_of_another_level_fade_in_and_those_of_the_same_do_not(avatar: Avatar) -> None:
    driver = FramePlanner(Scheduler())
    planned(driver, head(avatar))
    placement = Placement(slot="ada", world_from_head=np.eye(4, dtype=np.float32))
    driver.note_decoded(decoded("ada", 64), 1e-4, now=1.0)
    assert driver.dressed(placement, 1.0).blend == 1.0
    driver.note_decoded(decoded("ada", 128), 1e-4, now=2.0)
    blends = [driver.dressed(placement, 2.0 + part * BLEND_S).blend for part in (0, 0.5, 1, 3)]
    assert blends == pytest.approx([0, 0.5, 1, 1])
    driver.note_decoded(decoded("ada", 128), 1e-4, now=3.0)
    assert driver.dressed(placement, 3.0).blend == 1.0


def test_a_change_of_mesh_fades_in_too(avatar: Avatar) -> None:
    driver, far = FramePlanner(Scheduler()), head(avatar)
    far.world_from_head[2, 3] = -40.0
    near = head(avatar)
    placement = Placement(slot="ada", world_from_head=np.eye(4, dtype=np.float32))
    meshes = []
    for frame in range(60):
        now = frame * FRAME_S
        plan = planned(driver, near if frame < 20 else far, now=now)
        for _, request in driver.requests(plan, now):
            driver.note_decoded(decoded("ada", request.level), 1e-4, now=now)
        meshes.append(driver.dressed(placement, now))
    held = [each for each in meshes if each.is_same_maps]
    assert held, "a far head draws the maps that it has with fewer triangles"
    first = held[0]
    assert (first.mesh_level, first.mesh_before, first.blend) == (128, 256, 0.0)
    assert meshes[-1].blend == 1.0


def test_what_is_measured_reaches_the_cost_model(avatar: Avatar) -> None:
    driver = FramePlanner(Scheduler())
    planned(driver, head(avatar))
    model = f"{avatar.manifest.variant} {avatar.spec.block}"
    before_s = driver.scheduler.costs.decode_s(model, 256, "both")
    for _ in range(9):
        driver.note_decoded(decoded("ada", 256, decode_s=0.05), 1e-3, now=0.0)
    assert driver.scheduler.costs.decode_s(model, 256, "both") == pytest.approx(0.051, rel=0.01)
    assert before_s < 0.05


def test_both_eyes_share_one_decode(avatar: Avatar) -> None:
    driver = FramePlanner(Scheduler())
    eyes = [camera_at(side_m=side_m) for side_m in (-0.03, 0.03)]
    plan = driver.plan([head(avatar)], eyes, SIZE, AMPLE_S, 0.0)
    assert len(driver.requests(plan, 0.0)) == 1
    one = FramePlanner(Scheduler())
    planned(one, head(avatar))
    assert driver.expected_shading_px() == pytest.approx(2 * one.expected_shading_px(), rel=0.1)


def test_another_avatar_in_the_same_place_starts_anew(avatar: Avatar) -> None:
    driver = FramePlanner(Scheduler())
    driver.requests(planned(driver, head(avatar)), 0.0)
    other = make_toy_avatar(seed=9)
    ((_, request),) = driver.requests(planned(driver, head(other), now=FRAME_S), FRAME_S)
    assert request.level == other.spec.map_size


def test_views_are_those_of_the_scene(avatar: Avatar) -> None:
    driver = FramePlanner(Scheduler())
    side = head(avatar, x_m=0.3)
    camera = camera_at(side_m=-0.2)
    ((_, request),) = driver.requests(planned(driver, side, camera=camera), 0.0)
    wanted = view_direction(side.world_from_head, camera.centre_m)
    assert request.view_direction == pytest.approx(wanted, abs=1e-6)
    assert request.view_direction.dtype == np.float32


def test_an_empty_room_costs_nothing() -> None:
    plan = planned(FramePlanner(Scheduler()))
    assert plan.choices == {}
    assert plan.cost_s == 0
