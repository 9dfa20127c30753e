"""What fixed scenes and a fixed call cost, in counts, against ``counted_budgets.json``.

Times cannot be asserted on shared machines; counts can. Each count must stay within its budget, and
a budget within a tenth of its count. A change that raises a count raises its number in that file.
The counts are those of software GL; on a GPU the rasteriser may differ by some pixels.
"""

import asyncio
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import moderngl
import numpy as np
import pytest

from helpers.senders import LoadedAvatars, make_senders, run_senders
from pica_client.avatars.library import AvatarLibrary
from pica_client.bench.harness import front_camera
from pica_client.bench.scene import FPS, SPACING_M
from pica_client.call.call import Call
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.request import DecodeRequest, DecodeResult
from pica_client.endpoint import Receiver
from pica_client.publish import SenderConfig
from pica_client.render.renderer import Renderer
from pica_client.render.room import EMPTY_ROOM, Room
from pica_client.render.scene import Placement, head_matrix
from pica_client.schedule.head import Head
from pica_client.schedule.scheduler import Scheduler, requests_of
from pica_client.sources.source import make_performance
from pica_client.transport.connect import LinkConfig
from pica_client.ui.avatar_presenter import AvatarPresenter
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.camera import Camera
from pica_core.gl import create_context
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import run_virtual

pytestmark = [pytest.mark.render, pytest.mark.slow]

BUDGETS = json.loads(Path(__file__).with_name("counted_budgets.json").read_text())
SLACK = 0.9
"""Least share of its budget that a count uses."""
SIZE = (1280, 720)
PEOPLE = 5
SCENE_IMAGES, CALL_IMAGES, CALL_IMAGES_PER_S = 15, 100, 30.0
WARM_UP_S = 2.0


DECODE_S = 0.001
"""What every decode is said to take."""


class CountedPool:
    """Stands for `DecodePool`: decodes when its results are taken.

    Attributes:
        num_decodes: Decodes so far; those of the expression map alone count one half.
    """

    def __init__(self) -> None:
        self.num_decodes = 0.0
        self._decoders: dict[str, OnnxDecoder] = {}
        self._requests: dict[str, DecodeRequest] = {}

    def add(self, slot: str, avatar: Avatar) -> None:
        self._decoders[slot] = OnnxDecoder(avatar)

    def remove(self, slot: str) -> None:
        self._decoders.pop(slot, None)
        self._requests.pop(slot, None)

    def submit(self, slot: str, request: DecodeRequest) -> None:
        self._requests[slot] = request

    def take_results(self) -> list[DecodeResult]:
        results = []
        for slot, asked in self._requests.items():
            wanted = asked.latent, asked.view_direction, asked.level, asked.parts
            maps = self._decoders[slot].decode(*wanted)
            self.num_decodes += 1.0 if asked.parts == "both" else 0.5
            results.append(
                DecodeResult(
                    slot,
                    maps,
                    None,
                    captured_us=asked.captured_us,
                    finished_s=DECODE_S,
                    parts=asked.parts,
                )
            )
        self._requests.clear()
        return results


class CountedRenderer(Renderer):
    """A renderer that adds up what it draws; `counts` are means over the images."""

    def __init__(self, context: moderngl.Context, size: tuple[int, int]) -> None:
        super().__init__(context, size)
        self._sums: Counter[str] = Counter()
        self._num_images = 0

    def update_maps(self, slot: str, *maps: Any) -> None:
        with calls_counted(self._sums):
            super().update_maps(slot, *maps)
        self._sums["bytes_uploaded"] += sum(each.nbytes for each in maps if each is not None)

    def count(
        self, placements: Sequence[Placement], camera: Camera, room: Room = EMPTY_ROOM
    ) -> None:
        """Draw an image and count it."""
        with calls_counted(self._sums):
            stats = self.draw(placements, camera, room=room, count_pixels=True)
        self._num_images += 1
        self._sums["triangles"] += stats.num_triangles
        self._sums["decoded_pixels"] += stats.shaded_pixels or 0
        self._sums["textured_texels"] += stats.textured_pixels or 0

    def counts(self, pool: CountedPool) -> dict[str, float]:
        """Everything so far, an image."""
        sums = {"textured_texels": 0, **self._sums, "decodes": pool.num_decodes}
        return {name: round(total / self._num_images, 2) for name, total in sums.items()}


@contextmanager
def calls_counted(sums: Counter[str]) -> Iterator[None]:
    """Count calls into the GL binding under ``gl_calls``."""

    def on_event(_frame: FrameType, event: str, function: Any) -> None:
        if event == "c_call":
            owner = type(getattr(function, "__self__", None))
            sums["gl_calls"] += owner.__module__ == "mgl"

    before = sys.getprofile()
    sys.setprofile(on_event)
    try:
        yield
    finally:
        sys.setprofile(before)


@pytest.fixture(scope="module")
def avatars() -> Iterator[dict[str, Avatar]]:
    library = AvatarLibrary()
    identities = [library.find(name) for name in library.names[:PEOPLE]]
    yield {identity: library.load(identity) for identity in identities}
    library.close()


@pytest.fixture
def context() -> Iterator[moderngl.Context]:
    made = create_context()
    if "llvmpipe" not in made.info["GL_RENDERER"]:
        made.release()
        pytest.skip("the budgets are counted with llvmpipe")
    yield made
    made.release()


def assert_within_budget(counts: dict[str, float], name: str) -> None:
    budgets = BUDGETS[name]
    said = f"{name} costs {json.dumps(counts)}"
    assert set(counts) == set(budgets), said
    for count, budget in budgets.items():
        assert SLACK * budget <= counts[count] <= budget, f"{count}: {said}"


@pytest.mark.parametrize("distance_cm", [65, 90, 120])
def test_five_talking_heads_stay_within_their_budget(
    distance_cm: int, context: moderngl.Context, avatars: dict[str, Avatar]
) -> None:
    people = list(avatars.values())
    pool, scheduler = CountedPool(), Scheduler()
    heads = [Head(slot=f"head-{index}", avatar=each) for index, each in enumerate(people)]
    encoders = [ExpressionEncoder(avatar) for avatar in people]
    faces = [make_performance("talk", seed=i, start_s=2.3 * i) for i in range(len(people))]
    camera = front_camera(people[0].manifest, distance_cm, SIZE)
    with CountedRenderer(context, SIZE) as renderer:
        for head in heads:
            renderer.add_avatar(head.slot, head.avatar)
            pool.add(head.slot, head.avatar)
        for image in range(SCENE_IMAGES):
            now = image / FPS
            for index, head in enumerate(heads):
                face, seat = faces[index].frame_at(now), np.eye(4)
                seat[0, 3] = SPACING_M * ((index + 1) // 2) * (1 if index % 2 else -1)
                head.world_from_head = head_matrix(seat, face.rotation, face.translation_m)
                head.latent = encoders[index].encode(face.arkit)
                head.captured_us = round(now * 1e6)
            scheduler.plan_view(heads, [camera], SIZE, math.inf, now)
            for head, request in requests_of(heads, now):
                pool.submit(head.slot, request)
            by_slot = {head.slot: head for head in heads}
            for result in pool.take_results():
                assert result.maps is not None
                maps = result.maps.position_map, result.maps.expression_map
                renderer.update_maps(result.slot, *maps)
                scheduler.note_decoded(by_slot[result.slot], result, 0.0)
            placements = [
                head.dressed(Placement(slot=head.slot, world_from_head=head.world_from_head))
                for head in heads
            ]
            renderer.count(placements, camera)
        assert_within_budget(renderer.counts(pool), f"five heads at {distance_cm} cm")


async def hold_call(
    context: moderngl.Context, avatars: dict[str, Avatar]
) -> tuple[dict[str, float], dict[str, float]]:
    """The first images of a call of five senders, and what its network carried, a second."""
    loop, names = asyncio.get_running_loop(), [f"p{number}" for number in range(PEOPLE)]
    seconds = WARM_UP_S + CALL_IMAGES / CALL_IMAGES_PER_S
    async with Relay(RelayConfig(port=0)) as relay:
        link = {
            name: LinkConfig(url=relay.url, room="kitchen", name=name)
            for name in [*names, "viewer"]
        }
        config = SenderConfig(seconds=seconds + 1)
        senders = make_senders([link[n] for n in names], list(avatars.items()), config=config)
        call = Call(LoadedAvatars(avatars))
        receiver = Receiver(link["viewer"], call)
        pool = CountedPool()
        with CountedRenderer(context, SIZE) as renderer:
            presenter = AvatarPresenter(call, renderer, pool, Scheduler(), clock=lambda: 0.0)  # type: ignore[arg-type]
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(run_senders(senders))
                receiving = tasks.create_task(receiver.run())
                await asyncio.sleep(WARM_UP_S)
                for image in range(CALL_IMAGES):
                    now = WARM_UP_S + image / CALL_IMAGES_PER_S
                    await asyncio.sleep(now - loop.time())
                    scene = presenter.arrange(now, SIZE)
                    presenter.decide(scene, (scene.camera,), math.inf)
                    presenter.collect(now)
                    scene = presenter.dressed(scene)
                    renderer.count(scene.placements, scene.camera, scene.room)
                link, elapsed_s = receiver.link, loop.time()
                carried = {
                    "messages_received": link.received_messages / elapsed_s,
                    "bytes_received": link.received_wire_bytes / elapsed_s,
                }
                receiver.stop()
                await receiving
            counts = renderer.counts(pool)
    return counts, {name: round(value, 2) for name, value in carried.items()}


def test_the_first_images_of_a_call_of_five_stay_within_their_budget(
    context: moderngl.Context, avatars: dict[str, Avatar]
) -> None:
    drawn, carried = run_virtual(hold_call(context, avatars))
    assert_within_budget(drawn | carried, "call of five")
