"""The faces of a call on their way to the picture, without a viewer."""

import math
from collections.abc import Container, Iterator

import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_client.call.status import FaceState
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool
from pica_client.render.renderer import Renderer
from pica_client.schedule.scheduler import Scheduler
from pica_client.ui.avatar_presenter import AvatarPresenter, CallScene
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import AvatarSpec
from pica_core.gl import create_context

pytestmark = pytest.mark.render

TOY = make_toy_avatar(spec=AvatarSpec(uv_encoding_size=64, axis_encoding_size=64), grid=24)


class MovingFaces:
    """Two people whose faces and heads are never still, but for those who rest."""

    def __init__(self, pace: float = 1.0) -> None:
        self.pace = pace
        self.taken_s = {"p1": 0.0, "p2": 0.0}

    def faces(
        self, now: float, ahead_s: float = 0.0, resting: Container[str] = ()
    ) -> list[FaceState]:
        self.taken_s |= {peer_id: now for peer_id in self.taken_s if peer_id not in resting}
        return [
            FaceState(
                peer_id=peer_id,
                name="Ada",
                avatar_id="5" * 64,
                latent=np.full((8, 8, 4), self.pace * taken_s, np.float32),
                captured_us=round(1e6 * taken_s),
                rotation=np.array([0, 0.1 * taken_s, 0], np.float32),
            )
            for peer_id, taken_s in self.taken_s.items()
        ]

    def avatar(self, avatar_id: str) -> Avatar:
        return TOY

    def subscribe(self, peer_id: str, every: int, now: float) -> None:
        """There is no stream."""


Shown = tuple[AvatarPresenter, DecodePool, CallScene, float]


def images(faces: MovingFaces, levels: dict[str, int], budget_s: float) -> Iterator[Shown]:
    """A second of images, each with its moment, after what was to be decoded for it is."""
    context = create_context()
    with Renderer(context, (160, 90)) as renderer, DecodePool(OnnxDecoder) as pool:
        presenter = AvatarPresenter(faces, renderer, pool, Scheduler(), levels=lambda: levels)
        for image in range(31):
            now = 1 + image / 30
            scene = presenter.arrange(now, (160, 90))
            presenter.decide(scene, (scene.camera,), budget_s)
            pool.wait_idle(10.0)
            yield presenter, pool, scene, now
    context.release()


@pytest.mark.parametrize(("budget_s", "num_faces"), [(math.inf, 30), (0.0, 8)])
def test_listeners_keep_their_faces_for_longer_only_where_drawing_is_short(
    budget_s: float, num_faces: int
) -> None:
    seen: dict[str, set[bytes]] = {"p1": set(), "p2": set()}
    for presenter, _, scene, now in images(MovingFaces(), {"p1": 0, "p2": 127}, budget_s):
        presenter.collect(now)
        for placement in presenter.dressed(scene).placements if now > 1 else ():
            seen[placement.slot].add(placement.world_from_head.tobytes())
    assert len(seen["p1"]) == 30
    assert num_faces <= len(seen["p2"]) <= num_faces + 2


def test_a_resting_listener_is_not_drawn_again_for_another_resolution() -> None:
    seen = []
    for number, (presenter, _, scene, now) in enumerate(
        images(MovingFaces(), {"p1": 0, "p2": 127}, 0.0)
    ):
        presenter.collect(now)
        for head in (peer.head for peer in presenter._peers.values()):
            if head is not None and head.choice is not None:
                head.choice = head.choice._replace(scale=0.5 if number % 2 else 0.75)
        seen.append(presenter.dressed(scene).placements)
    looks = [[(each.world_from_head.tobytes(), each.scale) for each in pair] for pair in seen[1:]]
    speaker, listener = ({look[number] for look in looks} for number in (0, 1))
    assert len(speaker) == len({pose for pose, _ in speaker}) == 30
    assert len(listener) == len({pose for pose, _ in listener}) <= 10


@pytest.mark.parametrize("pace", [0.2, 1.0])
def test_a_face_that_waits_for_its_decode_is_the_newest_by_then(pace: float) -> None:
    """Whether a change is too small to be decoded at once, or drawing leaves no time for it."""
    ages_us = []
    for _, pool, _, now in images(MovingFaces(pace), {"p1": 0, "p2": 127}, 0.0):
        faces = [result for result in pool.take_results() if result.parts == "both"]
        ages_us += [round(1e6 * now) - face.captured_us for face in faces]
    assert len(ages_us) >= 8
    assert max(ages_us) <= 1
