"""Decoding in shaders, judged by numpy; who comes and goes; and where it cannot be done."""

import subprocess
import sys
from collections.abc import Container, Iterator
from typing import Any

import moderngl
import numpy as np
import pytest

from helpers import gl_es, tolerances
from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.call.status import FaceState
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool
from pica_client.decode.request import DecodeRequest, Parts
from pica_client.errors import OptionError
from pica_client.render import gpu_decoder
from pica_client.render.gpu_decoder import GpuDecoder, choose_decoder, draws_floats
from pica_client.render.renderer import Renderer
from pica_client.schedule.scheduler import Scheduler
from pica_client.ui.avatar_presenter import AvatarPresenter
from pica_core.avatar.file import Avatar, load_avatar, shipped_avatar_files
from pica_core.avatar.spec import AvatarSpec
from pica_core.reference import decode_expression_map, decode_position_map

pytestmark = pytest.mark.render

SHIPPED = {path.stem: load_avatar(path) for path in shipped_avatar_files()}
AMARA, NORA = SHIPPED["amara"], SHIPPED["nora"]
LINEAR = with_toy_levels(
    make_toy_avatar(spec=AvatarSpec(uv_encoding_size=16, axis_encoding_size=20), grid=40)
)
"""A toy whose vertices come from bases, in regions of falling rank."""


class Scene:
    """A renderer with a decoder, and what was asked for last."""

    def __init__(self, context: moderngl.Context) -> None:
        self.renderer = Renderer(context, (16, 16))
        self.decoder = GpuDecoder(context, self.renderer)
        self.avatars: dict[str, Avatar] = {}
        self._rng = np.random.default_rng(3)

    def add(self, slot: str, avatar: Avatar) -> None:
        self.renderer.add_avatar(slot, avatar)
        assert self.decoder.add(slot, avatar)
        self.avatars[slot] = avatar

    def remove(self, slot: str) -> None:
        self.renderer.remove(slot)
        self.decoder.remove(slot)

    def ask(self, slot: str, level: int, parts: Parts = "both") -> DecodeRequest:
        view = self._rng.standard_normal(3)
        latent = self._rng.standard_normal((8, 8, 4)).astype(np.float32)
        view = (view / np.linalg.norm(view)).astype(np.float32)
        request = DecodeRequest(latent, view, 0, level, parts)
        self.decoder.submit(slot, request)
        return request

    def assert_shows(self, slot: str, request: DecodeRequest) -> None:
        avatar, level = self.avatars[slot], request.level
        position, expression = self.renderer.read_maps(slot)
        codes = decode_expression_map(avatar, request.latent, request.view_direction, level)
        vertices_m = decode_position_map(avatar, request.latent, level)
        assert np.abs(expression - codes).max() < tolerances.EXPRESSION_GLSL
        assert np.abs(position - vertices_m).max() < tolerances.MAP_GLSL_M


@pytest.fixture
def scene(context: moderngl.Context) -> Iterator[Scene]:
    made = Scene(context)
    yield made
    made.decoder.close()
    made.renderer.close()


def test_one_batch_of_all_shipped_avatars_at_all_levels_makes_what_numpy_makes(
    scene: Scene,
) -> None:
    # Coarse ones are cheap for numpy.
    levels = dict.fromkeys(SHIPPED, 64) | {"amara": 256, "elias": 128}
    asked = {}
    for name, level in levels.items():
        scene.add(name, SHIPPED[name])
        asked[name] = scene.ask(name, level)
    results = {result.slot: result for result in scene.decoder.take_results()}
    assert {name: results[name].level for name in asked} == levels
    for name, request in asked.items():
        scene.assert_shows(name, request)


def test_a_level_follows_another_and_expressions_alone_leave_the_vertices(scene: Scene) -> None:
    scene.add("p", AMARA)
    scene.ask("p", 128)
    scene.decoder.take_results()
    asked = scene.ask("p", 64)
    scene.decoder.take_results()
    scene.assert_shows("p", asked)
    before, _ = scene.renderer.read_maps("p")
    turned = scene.ask("p", 64, "expression")
    scene.decoder.take_results()
    position, expression = scene.renderer.read_maps("p")
    assert np.array_equal(position, before)
    codes = decode_expression_map(AMARA, turned.latent, turned.view_direction, 64)
    assert np.abs(expression - codes).max() < tolerances.EXPRESSION_GLSL


def test_who_comes_after_somebody_left_is_decoded_with_numbers_of_their_own(scene: Scene) -> None:
    scene.add("first", AMARA)
    scene.ask("first", 64)
    scene.decoder.take_results()
    scene.remove("first")
    scene.decoder.submit("first", DecodeRequest(np.zeros((8, 8, 4)), np.zeros(3), 0))
    assert scene.decoder.take_results() == []
    asked = {}
    for slot, avatar in (("second", NORA), ("third", AMARA), ("fourth", NORA)):
        scene.add(slot, avatar)
        asked[slot] = scene.ask(slot, 64)
    scene.renderer.remove("third")  # left while its face was on its way
    assert {result.slot for result in scene.decoder.take_results()} == {"second", "fourth"}
    for slot in ("second", "fourth"):
        scene.assert_shows(slot, asked[slot])


def test_more_heads_than_a_batch_holds_are_decoded_in_turns(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gpu_decoder, "MAX_BATCH", 4)
    asked = {}
    for number in range(9):
        scene.add(str(number), AMARA)
        asked[str(number)] = scene.ask(str(number), 64)
    assert len(scene.decoder.take_results()) == len(asked)
    for slot in ("0", "3", "4", "8"):
        scene.assert_shows(slot, asked[slot])


def test_a_broken_face_spoils_no_other_one(scene: Scene) -> None:
    for slot in ("sound", "broken", "wrong"):
        scene.add(slot, AMARA)
    front = np.array([0, 0, 1], np.float32)
    scene.decoder.submit("broken", DecodeRequest(np.full((8, 8, 4), np.nan, "f4"), front, 0, 64))
    scene.decoder.submit("wrong", DecodeRequest(np.zeros((3, 8, 4), "f4"), front, 0, 64))
    asked = scene.ask("sound", 64)
    errors = {result.slot: result.error for result in scene.decoder.take_results()}
    assert errors["broken"] is None
    assert "(3, 8, 4)" in str(errors["wrong"])
    scene.assert_shows("sound", asked)


def test_avatars_that_shaders_do_not_evaluate_are_left_to_others(scene: Scene) -> None:
    assert not scene.decoder.add("toy", make_toy_avatar(grid=8))
    # Its weights are finer than those of a file.
    assert not scene.decoder.add("linear", LINEAR)


class WithoutFloats:
    """A context whose driver draws no floats."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def framebuffer(self, images: object) -> None:
        raise moderngl.Error("the framebuffer is not complete (UNSUPPORTED)")


def test_shaders_decode_where_a_gpu_draws_and_the_driver_can(
    context: moderngl.Context, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    lacking: Any = WithoutFloats(context)
    assert draws_floats(context)
    assert not draws_floats(lacking)
    monkeypatch.setattr(scene.renderer, "gl_renderer", "NVIDIA H200")
    assert isinstance(choose_decoder("auto", context, scene.renderer), GpuDecoder)
    assert choose_decoder("cpu", context, scene.renderer) is None
    assert choose_decoder("auto", lacking, scene.renderer) is None
    with pytest.raises(OptionError, match="NVIDIA H200 does not"):
        choose_decoder("gpu", lacking, scene.renderer)
    monkeypatch.setattr(scene.renderer, "gl_renderer", "llvmpipe (LLVM 15)")
    assert choose_decoder("auto", context, scene.renderer) is None
    assert isinstance(choose_decoder("gpu", context, scene.renderer), GpuDecoder)


class TwoFaces:
    """Two people who talk."""

    def faces(
        self, now: float, ahead_s: float = 0.0, resting: Container[str] = ()
    ) -> list[FaceState]:
        latent = np.full((8, 8, 4), 0.4, np.float32)
        return [
            FaceState(peer_id=name, name=name, avatar_id=name, latent=latent)
            for name in ("amara", "nora")
        ]

    def avatar(self, avatar_id: str) -> Avatar:
        return SHIPPED[avatar_id]

    def subscribe(self, peer_id: str, every: int, now: float) -> None:
        """There is no stream."""


def test_a_call_looks_alike_whoever_decodes(context: moderngl.Context) -> None:
    images = []
    for choice in ("cpu", "gpu"):
        with Renderer(context, (320, 180)) as renderer, DecodePool(OnnxDecoder) as pool:
            shaders = choose_decoder(choice, context, renderer)
            presenter = AvatarPresenter(TwoFaces(), renderer, pool, Scheduler(), shaders=shaders)
            scene = presenter.arrange(1.0, renderer.size)
            presenter.decide(scene, (scene.camera,), 1.0)
            pool.wait_idle(30.0)
            presenter.collect(1.0)  # shaders decode for the very image that asks
            renderer.draw(presenter.dressed(scene).placements, scene.camera)
            assert presenter.num_decoded() == {"amara": 1, "nora": 1}
            images.append(renderer.read_image().astype(int))
    # Vertices a few nanometres apart move some edges by a pixel.
    assert (np.abs(images[0] - images[1]) > 1).mean() < 1e-3


def test_a_driver_of_gl_es_takes_the_decoders_text() -> None:
    done = subprocess.run(
        [sys.executable, gl_es.__file__], capture_output=True, text=True, check=False
    )
    if done.returncode == gl_es.UNABLE:
        pytest.skip(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
