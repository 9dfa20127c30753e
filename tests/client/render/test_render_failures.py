"""Where drawing fails: broken maps, cameras in odd places, heads on heads, bad drivers."""

from __future__ import annotations

import ctypes
import math
import os
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import moderngl
import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_client.errors import ShaderError
from pica_client.render import gpu_avatar
from pica_client.render.layers import layer_size
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, head_matrix
from pica_core.avatar.spec import AvatarSpec
from pica_core.camera import Camera, look_at
from pica_core.errors import GraphicsError

pytestmark = pytest.mark.render

SIZE = (160, 120)
SPEC = AvatarSpec(uv_encoding_size=256)
TOY = make_toy_avatar(spec=SPEC, grid=40)
SISTER = make_toy_avatar(spec=SPEC, grid=40, seed=8)
POSITIONS = TOY.tensors["geometry.mean"]
CODES = np.random.default_rng(2).standard_normal((256, 256, 4)).astype(np.float32)
SHARP = RenderOptions(smooth_edges=False)
HUGE = 3e38


def camera_at(*centre_m: float, fov: float = 0.55) -> Camera:
    return look_at(
        centre_m=centre_m, target_m=(0, 0, 0), vertical_fov=fov, width=SIZE[0], height=SIZE[1]
    )


def placed(slot: str, x: float = 0, y: float = 0, z: float = 0, **choices: Any) -> Placement:
    matrix = head_matrix(np.eye(4), [0, 0, 0], [x, y, z])
    return replace(Placement(slot=slot, world_from_head=matrix), **choices)


def renderer_with(context: moderngl.Context, count: int) -> Renderer:
    renderer = Renderer(context, SIZE, SHARP)
    for index in range(count):
        renderer.add_avatar(f"p{index}", (TOY, SISTER)[index % 2])
        renderer.update_maps(f"p{index}", POSITIONS, CODES)
    return renderer


def painted_share(image: np.ndarray, room: np.ndarray) -> float:
    return float((image != room).any(axis=-1).mean())


@pytest.mark.parametrize("value", [np.nan, np.inf, -HUGE, HUGE])
@pytest.mark.parametrize("part", ["everywhere", "a row"])
def test_broken_maps_harm_nobody_else(context: moderngl.Context, value: float, part: str) -> None:
    renderer = renderer_with(context, 2)
    # The broken head is the nearer one, but beside its neighbour on the screen.
    both = [placed("p0", -0.2, 0, 0.3), placed("p1", 0.2, 0, 0)]
    camera = camera_at(0, 0, 1.5)
    renderer.draw([both[1]], camera)
    wanted, heads = renderer.read_image(), renderer.read_surface()[2]
    broken, codes = POSITIONS.copy(), CODES.copy()
    rows = slice(None) if part == "everywhere" else slice(100, 101)
    broken[rows], codes[rows] = value, value
    renderer.update_maps("p0", broken, codes)
    renderer.draw(both, camera)
    np.testing.assert_array_equal(renderer.read_image()[heads == 0], wanted[heads == 0])


def test_a_map_that_reaches_out_is_held_within_its_bounds(context: moderngl.Context) -> None:
    renderer = renderer_with(context, 1)
    renderer.update_maps("p0", POSITIONS * 50, CODES)
    camera = camera_at(0, 0, 1.5)
    renderer.draw([placed("p0")], camera)
    xyz_m, _, heads = renderer.read_surface()
    low, high = np.array(TOY.manifest.bounds_min_m), np.array(TOY.manifest.bounds_max_m)
    margin = gpu_avatar.BOUNDS_MARGIN_M + 1e-4
    assert (xyz_m[heads == 0] >= low - margin).all()
    assert (xyz_m[heads == 0] <= high + margin).all()


@pytest.mark.parametrize(
    "centre_m",
    [(0, 0, 0.001), (0, 0.02, 0.06), (0.05, 0, 0.02), (0, 0, 0.097), (0, 0, 0.12), (0, 0.0, -0.05)],
)
def test_a_camera_in_a_head_or_on_its_skin_draws_a_frame(
    context: moderngl.Context, centre_m: tuple[float, float, float]
) -> None:
    renderer = renderer_with(context, 1)
    stats = renderer.draw([placed("p0")], camera_at(*centre_m), count_pixels=True)
    assert stats.num_avatars == 1
    assert (stats.shaded_pixels or 0) <= SIZE[0] * SIZE[1]
    assert renderer.read_image().shape == (SIZE[1], SIZE[0], 3)


def test_a_head_that_fills_the_screen_shades_each_pixel_once(context: moderngl.Context) -> None:
    renderer = renderer_with(context, 1)
    stats = renderer.draw([placed("p0")], camera_at(0, 0, 0.25, fov=0.2), count_pixels=True)
    assert stats.shaded_pixels == math.prod(layer_size(SIZE))
    assert (renderer.read_surface()[2] == 0).all()


def test_heads_of_a_pixel_cost_a_pixel(context: moderngl.Context) -> None:
    renderer = renderer_with(context, 3)
    crowd = [placed(f"p{i}", 1.5 * i - 1.5, 0, 0) for i in range(3)]
    stats = renderer.draw(crowd, camera_at(0, 0, 19, fov=2.2), count_pixels=True)
    assert len(stats.drawn) == 3
    assert (stats.shaded_pixels or 0) <= 3 * 4


def test_a_pose_that_is_no_number_draws_nothing(context: moderngl.Context) -> None:
    renderer = renderer_with(context, 1)
    broken = Placement(slot="p0", world_from_head=np.full((4, 4), np.nan, np.float32))
    assert renderer.draw([broken], camera_at(0, 0, 1)).drawn == ()


def test_an_avatar_whose_shader_fails_leaves_the_others_alone(
    context: moderngl.Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    renderer = renderer_with(context, 1)
    both = [placed("p0", -0.15), placed("p1", 0.15)]
    camera = camera_at(0, 0, 1.2)
    renderer.draw(both[:1], camera)
    alone, heads = renderer.read_image(), renderer.read_surface()[2]
    monkeypatch.setattr(
        gpu_avatar,
        "siren_source",
        lambda *_, **__: "vec4 encode_xyz(vec3 x) { return odd_driver; }",
    )
    with pytest.raises(ShaderError, match=r"odd_driver.* in .vec4 encode_xyz"):
        renderer.add_avatar("p1", SISTER)
    stats = renderer.draw(both, camera)
    assert (stats.num_avatars, stats.num_placeholders) == (1, 1)
    np.testing.assert_array_equal(renderer.read_image()[heads == 0], alone[heads == 0])


def test_a_context_that_is_too_old_is_refused_with_the_fix() -> None:
    old = cast(moderngl.Context, SimpleNamespace(version_code=210))
    with pytest.raises(GraphicsError, match=r"version 2\.1; 3\.3 is needed: install or update"):
        Renderer(old, SIZE)


def test_a_driver_that_is_too_old_gives_no_context(context: moderngl.Context) -> None:
    if "Mesa" not in context.info["GL_VERSION"]:
        pytest.skip("only Mesa can be told to pretend to be older")
    script = (
        "from pica_core.gl import create_context\n"
        "from pica_core.errors import GraphicsError\n"
        "try:\n    create_context()\nexcept GraphicsError as error:\n    print(error)\n"
    )
    pretend = {"MESA_GL_VERSION_OVERRIDE": "2.1", "MESA_GLSL_VERSION_OVERRIDE": "120"}
    run = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, **pretend},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert run.stdout.startswith("no OpenGL 3.3 context")
    assert "update the graphics driver" in run.stdout


def test_what_the_driver_complains_of_comes_out_when_the_image_is_read(
    context: moderngl.Context,
) -> None:
    try:
        enable = ctypes.CDLL("libGL.so.1").glEnable
    except OSError:
        pytest.skip("glEnable cannot be called by name here")
    renderer = renderer_with(context, 1)
    renderer.draw([placed("p0")], camera_at(0, 0, 1))
    enable(0xFFFF)  # there is no such thing to enable
    with pytest.raises(GraphicsError, match="driver reports GL_INVALID_ENUM"):
        renderer.read_image()
    renderer.draw([placed("p0")], camera_at(0, 0, 1))
    renderer.read_image()
