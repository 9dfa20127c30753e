"""What the planner sees of heads, and what becomes of the scheduler's plans."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.decode.request import DecodedMaps, DecodeRequest, DecodeResult
from pica_client.render.scene import Placement, head_matrix, view_direction
from pica_client.schedule.frame_planner import FramePlanner
from pica_client.schedule.head import BLEND_S, Head
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


def head(avatar: Avatar, slot: str = "ada", x_m: float = 0.0) -> Head:
    seat = np.eye(4)
    seat[0, 3] = x_m
    matrix = head_matrix(seat, np.zeros(3), np.zeros(3))
    return Head(slot=slot, avatar=avatar, world_from_head=matrix)


def planned(
    planner: FramePlanner, *heads: Head, camera: Camera | None = None, now: float = 0.0
) -> Plan:
    return planner.plan(heads, [camera or camera_at()], SIZE, AMPLE_S, now)


def asked(
    planner: FramePlanner, *heads: Head, camera: Camera | None = None, now: float = 0.0
) -> list[tuple[Head, DecodeRequest]]:
    planned(planner, *heads, camera=camera, now=now)
    return planner.requests(heads, now)


def decoded(slot: str, level: int, decode_s: float = 1e-3) -> DecodeResult:
    empty: npt.NDArray[np.float32] = np.zeros((level, level, 3), np.float32)
    maps = DecodedMaps(empty, np.zeros((level, level, 4), np.float32), level)
    return DecodeResult(slot, maps, None, started_s=0.0, finished_s=decode_s, level=level)


def test_a_face_that_is_new_is_decoded_and_one_that_stands_still_is_not(avatar: Avatar) -> None:
    planner, ada = FramePlanner(Scheduler()), head(avatar)
    assert [each for each, _ in asked(planner, ada)] == [ada]
    assert asked(planner, ada, now=FRAME_S) == []


def test_a_face_that_moves_is_decoded_anew_with_its_newest_latent(avatar: Avatar) -> None:
    planner, ada = FramePlanner(Scheduler()), head(avatar)
    asked(planner, ada)
    ada.latent = np.ones_like(ada.latent)
    ((_, request),) = asked(planner, ada, now=FRAME_S)
    assert request.parts == "both"
    assert request.latent is ada.latent


def test_a_view_that_turns_past_a_still_face_makes_its_expression_map_alone(
    avatar: Avatar,
) -> None:
    planner, still = FramePlanner(Scheduler()), head(avatar)
    asked(planner, still)
    ((_, request),) = asked(planner, still, camera=camera_at(side_m=0.6), now=FRAME_S)
    assert request.parts == "expression"
    assert request.latent is still.latent
    assert request.view_direction[0] > 0.3


def test_behind_the_viewer_nothing_is_decoded_and_the_stream_is_given_up_later(
    avatar: Avatar,
) -> None:
    planner, ada = FramePlanner(Scheduler()), head(avatar)
    away = camera_at(away=True)
    wanted = []
    for frame in range(90):
        ada.latent = np.full_like(ada.latent, frame)
        now = frame * FRAME_S
        plan = planned(planner, ada, camera=away, now=now)
        assert planner.requests([ada], now) == []
        wanted.append(plan.choices["ada"].every)
    assert (wanted[0], wanted[-1]) == (1, 0)


def test_who_comes_back_into_view_is_decoded_in_the_very_next_frame(avatar: Avatar) -> None:
    planner, ada = FramePlanner(Scheduler()), head(avatar)
    for frame in range(60):
        planned(planner, ada, camera=camera_at(away=True), now=frame * FRAME_S)
    assert len(asked(planner, ada, now=2.0)) == 1
    assert ada.choice is not None
    assert ada.choice.every


def test_where_time_is_short_a_far_head_gives_up_more_than_a_near_one(avatar: Avatar) -> None:
    def pair() -> tuple[Head, Head]:
        near, far = head(avatar, "near"), head(avatar, "far", x_m=1.0)
        far.world_from_head[2, 3] = -2.0
        return near, far

    free = planned(FramePlanner(Scheduler()), *pair())
    budget_s = free.floor_s + 0.7 * (free.cost_s - free.floor_s)
    plan = FramePlanner(Scheduler()).plan(pair(), [camera_at()], SIZE, budget_s, 0.0)
    assert plan.choices["far"].is_limited
    assert plan.choices["far"].level < plan.choices["near"].level


def test_maps_of_another_level_fade_in_and_those_of_the_same_do_not(avatar: Avatar) -> None:
    planner, ada = FramePlanner(Scheduler()), head(avatar)
    planned(planner, ada)
    placement = Placement(slot="ada", world_from_head=np.eye(4, dtype=np.float32))
    planner.note_decoded(ada, decoded("ada", 64), 1e-4, now=1.0)
    assert ada.dressed(placement, 1.0).blend == 1.0
    planner.note_decoded(ada, decoded("ada", 128), 1e-4, now=2.0)
    blends = [ada.dressed(placement, 2.0 + part * BLEND_S).blend for part in (0, 0.5, 1, 3)]
    assert blends == pytest.approx([0, 0.5, 1, 1])
    planner.note_decoded(ada, decoded("ada", 128), 1e-4, now=3.0)
    assert ada.dressed(placement, 3.0).blend == 1.0


def test_a_change_of_mesh_fades_in_too(avatar: Avatar) -> None:
    planner, ada = FramePlanner(Scheduler()), head(avatar)
    placement = Placement(slot="ada", world_from_head=np.eye(4, dtype=np.float32))
    meshes = []
    for frame in range(60):
        now = frame * FRAME_S
        ada.world_from_head[2, 3] = 0.5 if frame < 20 else -0.4
        for _, request in asked(planner, ada, now=now):
            planner.note_decoded(ada, decoded("ada", request.level or 0), 1e-4, now=now)
        meshes.append(ada.dressed(placement, now))
    held = [each for each in meshes if each.is_same_maps]
    assert held, "a far head draws the maps that it has with fewer triangles"
    first = held[0]
    assert (first.mesh_level, first.mesh_before, first.blend) == (128, 256, 0.0)
    assert meshes[-1].blend == 1.0


def test_what_is_measured_reaches_the_cost_model(avatar: Avatar) -> None:
    planner, ada = FramePlanner(Scheduler()), head(avatar)
    planned(planner, ada)
    model = f"{avatar.manifest.variant} {avatar.spec.block}"
    before_s = planner.scheduler.costs.decode_s(model, 256, "both")
    for _ in range(9):
        planner.note_decoded(ada, decoded("ada", 256, decode_s=0.05), 1e-3, now=0.0)
    assert planner.scheduler.costs.decode_s(model, 256, "both") == pytest.approx(0.051, rel=0.01)
    assert before_s < 0.05


def test_both_eyes_share_one_decode(avatar: Avatar) -> None:
    planner, ada = FramePlanner(Scheduler()), head(avatar)
    eyes = [camera_at(side_m=side_m) for side_m in (-0.03, 0.03)]
    plan = planner.plan([ada], eyes, SIZE, AMPLE_S, 0.0)
    assert len(planner.requests([ada], 0.0)) == 1
    one = planned(FramePlanner(Scheduler()), head(avatar))
    assert plan.shaded_px == pytest.approx(2 * one.shaded_px, rel=0.1)


def test_views_are_those_of_the_scene(avatar: Avatar) -> None:
    side = head(avatar, x_m=0.3)
    camera = camera_at(side_m=-0.2)
    ((_, request),) = asked(FramePlanner(Scheduler()), side, camera=camera)
    wanted = view_direction(side.world_from_head, camera.centre_m)
    assert request.view_direction == pytest.approx(wanted, abs=1e-6)
    assert request.view_direction.dtype == np.float32


def test_a_latent_of_another_shape_is_decoded_for_the_decoder_to_refuse(avatar: Avatar) -> None:
    planner, ada = FramePlanner(Scheduler()), head(avatar)
    asked(planner, ada)
    ada.latent = np.zeros((2, 2), np.float32)
    ((_, request),) = asked(planner, ada, now=FRAME_S)
    assert request.latent is ada.latent


def test_an_empty_room_costs_nothing() -> None:
    plan = planned(FramePlanner(Scheduler()))
    assert plan.choices == {}
    assert plan.cost_s == 0
