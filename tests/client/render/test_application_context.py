"""In the context of an application that embeds the renderer: what is freed, whose state counts."""

import ctypes
import sys
from collections.abc import Callable, Iterator
from typing import Any

import moderngl
import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_client.render.renderer import Renderer
from pica_client.render.scene import Placement
from pica_core.avatar.spec import AvatarSpec
from pica_core.camera import look_at
from pica_core.gl import create_context

pytestmark = pytest.mark.render

SIZE = (96, 64)
TOY = make_toy_avatar(spec=AvatarSpec(uv_encoding_size=256), grid=40)
CODES = np.random.default_rng(2).standard_normal((256, 256, 4)).astype(np.float32)
CAMERA = look_at(
    centre_m=(0.1, 0.05, 0.7), target_m=(0, 0, 0), vertical_fov=0.55, width=96, height=64
)
KINDS = ("Texture", "Buffer", "Program", "Framebuffer", "VertexArray", "Renderbuffer")
MODES = (None, "context_gc", "auto")


@pytest.fixture(params=MODES)
def context(request: pytest.FixtureRequest) -> Iterator[moderngl.Context]:
    made = create_context()
    made.gc_mode = request.param
    yield made
    made.release()


def num_objects() -> dict[str, int]:
    """GL objects that the driver holds in the current context."""
    if sys.platform != "linux":
        pytest.skip("the driver is asked by the name that it has on Linux")
    driver = ctypes.CDLL("libGL.so.1")
    return {kind: sum(getattr(driver, f"glIs{kind}")(n) & 1 for n in range(500)) for kind in KINDS}


def join(renderer: Renderer) -> None:
    renderer.add_avatar("p0", TOY)
    renderer.update_maps("p0", TOY.tensors["geometry.mean"], CODES)
    renderer.add_placeholder("p1")


def picture(renderer: Renderer) -> np.ndarray:
    renderer.draw([Placement(slot="p0", world_from_head=np.eye(4, dtype=np.float32))], CAMERA)
    return renderer.read_image()


def test_who_leaves_and_an_old_size_take_nothing_on_the_gpu(context: moderngl.Context) -> None:
    renderer = Renderer(context, SIZE)
    join(renderer)
    shown, before = picture(renderer), num_objects()
    for columns in (64, 80, 96):
        renderer.remove("p0")
        renderer.resize((columns, 64))
        join(renderer)
        again = picture(renderer)
    np.testing.assert_array_equal(again, shown)
    assert num_objects() == before
    assert context.error == "GL_NO_ERROR"


def test_a_closed_renderer_leaves_nothing_on_the_gpu(context: moderngl.Context) -> None:
    own = context.simple_framebuffer((4, 4))
    before = num_objects()
    with Renderer(context, SIZE) as renderer:
        join(renderer)
        picture(renderer)
    renderer.close()
    renderer.remove("p0")
    # The program that was used last goes when another is used.
    assert num_objects() == before | {"Program": before["Program"] + 1}
    own.read()
    assert context.error == "GL_NO_ERROR"


def leave(context: moderngl.Context, **state: Any) -> None:
    for name, value in state.items():
        setattr(context, name, value)


LEFT: dict[str, Callable[[moderngl.Context], object]] = {
    "blending": lambda context: context.enable(moderngl.BLEND),
    "depth_test": lambda context: context.enable(moderngl.DEPTH_TEST | moderngl.CULL_FACE),
    "nothing_drawn": lambda context: context.enable(moderngl.RASTERIZER_DISCARD),
    "clockwise": lambda context: leave(context, front_face="cw"),
    "front_culled": lambda context: leave(context, cull_face="front"),
    "lines": lambda context: leave(context, wireframe=True),
    "far_first": lambda context: leave(context, depth_func=">"),
    "offset": lambda context: leave(context, polygon_offset=(5.0, 5.0)),
    "depth_range": lambda context: leave(context, depth_clamp_range=(0.5, 0.5)),
    "samplers": lambda context: [
        context.sampler(filter=(moderngl.NEAREST, moderngl.NEAREST), repeat_x=True).use(unit)
        for unit in range(10)
    ],
}


@pytest.mark.parametrize("left", LEFT)
def test_what_an_application_leaves_does_not_change_the_picture(left: str) -> None:
    context = create_context()
    context.gc_mode = None
    renderer = Renderer(context, SIZE)
    join(renderer)
    shown = picture(renderer)
    renderer.resize((64, 64))
    renderer.resize(SIZE)  # so that the room is drawn, too
    LEFT[left](context)
    again = picture(renderer)
    context.release()
    np.testing.assert_array_equal(again, shown)
