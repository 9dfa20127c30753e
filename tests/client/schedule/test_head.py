"""What a head asks for as it moves, and how what came is drawn."""

import math

import numpy as np
import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.decode.request import DecodeRequest
from pica_client.render.scene import head_matrix
from pica_client.schedule.head import Head
from pica_client.schedule.scheduler import Plan, Scheduler, requests_of
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
    scheduler: Scheduler, *heads: Head, camera: Camera | None = None, now: float = 0.0
) -> Plan:
    return scheduler.plan_view(heads, [camera or camera_at()], SIZE, AMPLE_S, now)


def asked(
    scheduler: Scheduler, *heads: Head, camera: Camera | None = None, now: float = 0.0
) -> list[DecodeRequest]:
    planned(scheduler, *heads, camera=camera, now=now)
    return [request for _, request in requests_of(heads, now)]


def test_a_face_is_decoded_when_it_is_new_and_when_it_has_moved(avatar: Avatar) -> None:
    scheduler, ada = Scheduler(), head(avatar)
    assert len(asked(scheduler, ada)) == 1
    assert asked(scheduler, ada, now=FRAME_S) == []
    ada.latent = np.ones_like(ada.latent)
    (request,) = asked(scheduler, ada, now=2 * FRAME_S)
    assert request.parts == "both"
    assert request.latent is ada.latent


def test_a_view_that_turns_past_a_still_face_makes_its_expression_map_alone(
    avatar: Avatar,
) -> None:
    scheduler, still = Scheduler(), head(avatar)
    still.captured_us = 33_000
    asked(scheduler, still)
    (request,) = asked(scheduler, still, camera=camera_at(side_m=0.6), now=FRAME_S)
    assert (request.parts, request.captured_us) == ("expression", 33_000)
    assert request.latent is still.latent
    assert request.view_direction[0] > 0.3


def test_an_expression_map_for_an_older_latent_says_its_age(avatar: Avatar) -> None:
    scheduler, ada = Scheduler(), head(avatar)
    asked(scheduler, ada)
    ada.captured_us, ada.latent = 33_000, ada.latent + np.float32(0.01)
    (request,) = asked(scheduler, ada, camera=camera_at(side_m=0.6), now=FRAME_S)
    assert (request.parts, request.captured_us) == ("expression", 0)


def test_behind_the_viewer_nothing_is_decoded_until_it_comes_back(avatar: Avatar) -> None:
    scheduler, ada = Scheduler(), head(avatar)
    away, wanted = camera_at(away=True), []
    for frame in range(60):
        ada.latent = np.full_like(ada.latent, frame)
        assert asked(scheduler, ada, camera=away, now=frame * FRAME_S) == []
        assert ada.choice is not None
        wanted.append(ada.choice.every)
    assert (wanted[0], wanted[-1]) == (1, 0)
    assert len(asked(scheduler, ada, now=2.0)) == 1
    assert ada.choice.every


def test_both_eyes_share_one_decode(avatar: Avatar) -> None:
    ada, scheduler = head(avatar), Scheduler()
    eyes = [camera_at(side_m=side_m) for side_m in (-0.03, 0.03)]
    plan = scheduler.plan_view([ada], eyes, SIZE, AMPLE_S, 0.0)
    assert len(requests_of([ada], 0.0)) == 1
    one = planned(Scheduler(), head(avatar))
    assert plan.shaded_px == pytest.approx(2 * one.shaded_px, rel=0.1)
