"""What the renderer draws, judged by numpy; and where it fails: broken maps, cameras, drivers."""

import ctypes
import gc
import math
import os
import platform
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import moderngl
import numpy as np
import pytest
from PIL import Image

from helpers import tolerances
from helpers.paths import GOLDEN
from helpers.toy import make_toy_avatar
from pica_client.decode.decoder import OnnxDecoder
from pica_client.errors import OptionError, ShaderError
from pica_client.render import gpu_avatar
from pica_client.render.gpu_program import build_program, compose
from pica_client.render.gpu_tables import siren_source
from pica_client.render.layers import layer_size
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.room import Room
from pica_client.render.scene import Placement, head_matrix, view_direction
from pica_client.render.seats import plan_seats
from pica_client.render.views import ViewState, plan_camera
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import ENCODINGS, AvatarSpec
from pica_core.camera import Camera, look_at
from pica_core.errors import GraphicsError
from pica_core.reference import decode_pixels
from pica_core.sampling import sample_bilinear

pytestmark = pytest.mark.render

SIZE = (160, 120)
TOY = make_toy_avatar(spec=AvatarSpec(uv_encoding_size=256), grid=40)
SISTER = make_toy_avatar(spec=AvatarSpec(uv_encoding_size=256), grid=40, seed=8)
ENCODED = {
    name: make_toy_avatar(
        spec=AvatarSpec(encoding=name, uv_encoding_size=128, axis_encoding_size=300), grid=32
    )
    for name in ENCODINGS
}
EXACT = RenderOptions(smooth_edges=False)
UNFILTERED = RenderOptions(smooth_edges=False, filter_encodings=False)


def camera_at(*centre_m: float, fov: float = 0.55) -> Camera:
    return look_at(
        centre_m=centre_m, target_m=(0, 0, 0), vertical_fov=fov, width=SIZE[0], height=SIZE[1]
    )


def still(slot: str, x: float = 0, y: float = 0, z: float = 0, *, fade: float = 0) -> Placement:
    matrix = head_matrix(np.eye(4), [0, 0, 0], [x, y, z])
    return Placement(slot=slot, world_from_head=matrix, fade=fade)


def some_maps(avatar: Avatar, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    latent = np.random.default_rng(seed).standard_normal((8, 8, 4)).astype(np.float32)
    maps = OnnxDecoder(avatar).decode(latent, np.array([0, 0, 1], np.float32))
    return maps.position_map, maps.expression_map


def renderer_with(
    context: moderngl.Context,
    *avatars: Avatar,
    options: RenderOptions = EXACT,
    size: tuple[int, int] = SIZE,
) -> Renderer:
    renderer = Renderer(context, size, options)
    for index, avatar in enumerate(avatars):
        renderer.add_avatar(f"p{index}", avatar)
        renderer.update_maps(f"p{index}", *some_maps(avatar))
    return renderer


def test_positions_under_the_pixels_lie_where_their_camera_rays_meet_the_mesh(
    context: moderngl.Context,
) -> None:
    renderer = renderer_with(context, TOY)
    camera = camera_at(0.1, 0.05, 0.7)
    renderer.draw([still("p0")], camera)
    xyz_m, _, heads = renderer.read_surface()
    rows, columns = np.nonzero(heads == 0)
    pixels, _ = camera.project(xyz_m[rows, columns])
    np.testing.assert_allclose(pixels, np.stack([columns, rows], axis=1) + 0.5, atol=0.05)


@pytest.mark.parametrize("weights", ["block", "turns"])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_pixel_has_the_colour_that_numpy_computes(
    context: moderngl.Context, encoding: str, weights: str
) -> None:
    avatar = ENCODED[encoding]
    options = replace(UNFILTERED, weights=weights)  # type: ignore[arg-type]
    renderer = renderer_with(context, avatar, options=options)
    renderer.draw([still("p0")], camera_at(0.1, 0.02, 0.5))
    image = renderer.read_image()
    xyz_m, uv, heads = renderer.read_surface()
    covered = heads == 0
    codes = sample_bilinear(some_maps(avatar)[1], uv[covered], np.float64)
    rgb = decode_pixels(avatar.spec, avatar.tensors, codes, xyz_m[covered], uv[covered], np.float64)
    wanted = np.clip(rgb, 0, 1) * 255
    assert covered.sum() > 1000
    assert np.abs(image[covered].astype(float) - wanted).max() <= 255 * tolerances.PIXEL_GLSL


@pytest.mark.parametrize("encoding", ["sinusoids", "axes"])
def test_what_a_pixel_cannot_resolve_is_averaged(context: moderngl.Context, encoding: str) -> None:
    roughness = []
    for options in (EXACT, UNFILTERED):
        renderer = renderer_with(context, ENCODED[encoding], options=options)
        renderer.draw([still("p0")], camera_at(0.1, 0.02, 0.5))
        face = renderer.read_image()[25:87, 53:107].astype(float)
        roughness.append(np.abs(np.diff(face, axis=1)).mean())
    assert roughness[0] < roughness[1]


def test_a_nearer_head_hides_a_farther_one(context: moderngl.Context) -> None:
    renderer = renderer_with(context, TOY, SISTER)
    renderer.draw([still("p0", 0, 0, 0.25), still("p1", 0, 0, -0.25)], camera_at(0, 0, 1.2))
    _, _, heads = renderer.read_surface()
    assert (heads == 1).sum() < 0.2 * (heads == 0).sum()


@pytest.mark.parametrize("z", [3.0, math.nan])
def test_a_head_behind_the_camera_or_nowhere_costs_nothing(
    context: moderngl.Context, z: float
) -> None:
    renderer = renderer_with(context, TOY)
    stats = renderer.draw([still("p0", 0, 0, z)], camera_at(0, 0, 1), count_pixels=True)
    assert (stats.num_avatars, stats.num_triangles, stats.shaded_pixels) == (0, 0, 0)


def test_until_its_maps_come_an_avatar_is_a_placeholder(context: moderngl.Context) -> None:
    renderer = Renderer(context, SIZE, EXACT)
    renderer.add_avatar("p0", TOY)
    stats = renderer.draw([still("p0")], camera_at(0, 0, 0.9))
    assert (stats.num_avatars, stats.num_placeholders) == (0, 1)
    renderer.update_maps("p0", *some_maps(TOY))
    stats = renderer.draw([still("p0")], camera_at(0, 0, 0.9))
    assert (stats.num_avatars, stats.num_placeholders) == (1, 0)


def test_a_slot_that_left_is_drawn_no_more(context: moderngl.Context) -> None:
    renderer = renderer_with(context, TOY)
    renderer.remove("p0")
    renderer.remove("never-there")
    renderer.update_maps("p0", *some_maps(TOY))
    assert renderer.draw([still("p0")], camera_at(0, 0, 0.9)).num_triangles == 0


@pytest.mark.parametrize(("weights", "programs"), [("block", 0), ("turns", 1)])
def test_weights_in_a_block_let_avatars_of_a_spec_share_a_program(
    context: moderngl.Context, weights: str, programs: int
) -> None:
    def count() -> int:
        return sum(type(item) is moderngl.Program for item in gc.get_objects())

    options = RenderOptions(weights=weights, smooth_edges=False)  # type: ignore[arg-type]
    alone = renderer_with(context, SISTER, options=options)
    alone.draw([still("p0")], camera_at(0, 0, 0.9))
    renderer = renderer_with(context, TOY, options=options)
    before = count()
    renderer.add_avatar("p1", SISTER)
    assert count() == before + programs
    renderer.update_maps("p1", *some_maps(SISTER))
    renderer.draw([still("p1")], camera_at(0, 0, 0.9))
    np.testing.assert_array_equal(renderer.read_image(), alone.read_image())


def test_a_window_shows_what_is_read_without_one(context: moderngl.Context) -> None:
    renderer = renderer_with(context, TOY, options=RenderOptions())
    renderer.draw([still("p0")], camera_at(0, 0, 0.9))
    window = context.simple_framebuffer(SIZE)
    renderer.present(window)
    shown = np.frombuffer(window.read(), np.uint8).reshape(SIZE[1], SIZE[0], 3)[::-1]
    np.testing.assert_array_equal(shown, renderer.read_image())


@pytest.mark.parametrize("size", [(0, 10), (10, 9000)])
def test_a_size_out_of_range_is_refused(context: moderngl.Context, size: tuple[int, int]) -> None:
    with pytest.raises(OptionError, match="each side may be 1 to 8192"):
        Renderer(context, size)


@pytest.mark.parametrize(
    ("vertex", "fragment", "define"),
    [
        ("mesh.vert", "surface.frag", "MAPPED"),
        ("rect.vert", "pixel_decoder.frag", "FILTERED"),
        ("mesh.vert", "textured.frag", ""),
        ("rect.vert", "place_head.frag", ""),
        ("rect.vert", "finish_head.frag", ""),
        ("rect.vert", "background.frag", ""),
    ],
)
def test_the_browsers_dialect_compiles(
    context: moderngl.Context, vertex: str, fragment: str, define: str
) -> None:
    if "GL_ARB_ES3_compatibility" not in context.extensions:
        pytest.skip("this driver does not compile GLSL ES")
    generated, defines = {"siren.glsl": siren_source(TOY.spec)}, {define: ""} if define else {}
    vertex_source, fragment_source = (
        compose(name, TOY.spec, dialect="300 es", generated=generated, defines=defines)
        for name in (vertex, fragment)
    )
    build_program(context, vertex_source, fragment_source)


def test_five_seats_look_as_they_did(
    context: moderngl.Context, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    size = (320, 180)
    renderer = renderer_with(
        context, TOY, SISTER, TOY, SISTER, options=RenderOptions(fade_busts=True), size=size
    )
    renderer.add_placeholder("p4")
    plan = plan_seats("line", 5, 16 / 9)
    camera = plan_camera(plan, ViewState(), *size)
    placements = []
    for index, seat in enumerate(plan.seats):
        matrix = head_matrix(seat, [0.1 * index - 0.2, 0.2 - 0.1 * index, 0.0], [0, 0, 0])
        placements.append(
            Placement(slot=f"p{index}", world_from_head=matrix, fade=0.7 * (index == 3))
        )
        assert view_direction(matrix, camera.centre_m).shape == (3,)
    seats = tuple(
        (float(x), float(y), float(z)) for x, y, z in (seat[:3, 3] for seat in plan.seats)
    )
    renderer.draw(placements, camera, room=Room(seats_m=seats, speaking=(0, 0, 1, 0, 0)))
    image = renderer.read_image()
    golden = GOLDEN / "five_seats.png"
    if request.config.getoption("--regenerate-golden"):
        Image.fromarray(image).save(golden)
    if "llvmpipe" not in renderer.gl_renderer or platform.machine() != "x86_64":
        pytest.skip("golden images are compared on x86-64 llvmpipe only")
    with Image.open(golden) as file:
        wanted = np.asarray(file.convert("RGB"), np.int16)
    difference = np.abs(image.astype(np.int16) - wanted)
    if difference.max() > tolerances.GOLDEN_IMAGE * 255:
        amplified = np.clip(difference * 32, 0, 255).astype(np.uint8)
        Image.fromarray(amplified).save(tmp_path / "five_seats_difference.png")
        Image.fromarray(image).save(tmp_path / "five_seats.png")
        pytest.fail(f"differs by up to {difference.max()} of 255; see {tmp_path}")


@pytest.mark.parametrize("value", [np.nan, np.inf, -3e38, 3e38])
@pytest.mark.parametrize("part", ["everywhere", "a row"])
def test_broken_maps_harm_nobody_else(context: moderngl.Context, value: float, part: str) -> None:
    renderer = renderer_with(context, TOY, SISTER)
    # The broken head is the nearer one, but beside its neighbour on the screen.
    both = [still("p0", -0.2, 0, 0.3), still("p1", 0.2)]
    camera = camera_at(0, 0, 1.5)
    renderer.draw([both[1]], camera)
    wanted, heads = renderer.read_image(), renderer.read_surface()[2]
    broken, codes = (each.copy() for each in some_maps(TOY))
    rows = slice(None) if part == "everywhere" else slice(100, 101)
    broken[rows], codes[rows] = value, value
    renderer.update_maps("p0", broken, codes)
    renderer.draw(both, camera)
    np.testing.assert_array_equal(renderer.read_image()[heads == 0], wanted[heads == 0])


def test_a_map_that_reaches_out_is_held_within_its_bounds(context: moderngl.Context) -> None:
    renderer = renderer_with(context, TOY)
    positions, codes = some_maps(TOY)
    renderer.update_maps("p0", positions * 50, codes)
    camera = camera_at(0, 0, 1.5)
    renderer.draw([still("p0")], camera)
    xyz_m, _, heads = renderer.read_surface()
    low, high = np.array(TOY.manifest.bounds_min_m), np.array(TOY.manifest.bounds_max_m)
    margin = gpu_avatar.BOUNDS_MARGIN_M + 1e-4
    assert (xyz_m[heads == 0] >= low - margin).all()
    assert (xyz_m[heads == 0] <= high + margin).all()


@pytest.mark.parametrize(
    ("centre_m", "most"),
    [
        ((0, 0, 0.001), 0),  # the inside is not drawn
        ((0, 0.02, 0.06), math.prod(SIZE)),
        ((0.05, 0, 0.02), math.prod(SIZE)),
        ((0, 0, 0.097), math.prod(SIZE)),
        ((0, 0, 0.12), math.prod(SIZE)),
        ((0, 0, -0.05), math.prod(SIZE)),
    ],
)
def test_a_camera_in_a_head_or_on_its_skin_draws_a_frame(
    context: moderngl.Context, centre_m: tuple[float, float, float], most: int
) -> None:
    renderer = renderer_with(context, TOY)
    stats = renderer.draw([still("p0")], camera_at(*centre_m), count_pixels=True)
    assert stats.num_avatars == 1
    assert (stats.shaded_pixels or 0) <= most
    assert renderer.read_image().shape == (SIZE[1], SIZE[0], 3)


def test_a_head_that_fills_the_screen_shades_each_pixel_once(context: moderngl.Context) -> None:
    renderer = renderer_with(context, TOY)
    stats = renderer.draw([still("p0")], camera_at(0, 0, 0.25, fov=0.2), count_pixels=True)
    assert stats.shaded_pixels == math.prod(layer_size(SIZE))
    assert (renderer.read_surface()[2] == 0).all()


def test_heads_of_a_pixel_cost_a_pixel(context: moderngl.Context) -> None:
    renderer = renderer_with(context, TOY, SISTER, TOY)
    crowd = [still(f"p{i}", 1.5 * i - 1.5, 0, 0) for i in range(3)]
    stats = renderer.draw(crowd, camera_at(0, 0, 19, fov=2.2), count_pixels=True)
    assert len(stats.drawn) == 3
    assert (stats.shaded_pixels or 0) <= 3 * 4


def test_an_avatar_whose_shader_fails_leaves_the_others_alone(
    context: moderngl.Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    renderer = renderer_with(context, TOY)
    both = [still("p0", -0.15), still("p1", 0.15)]
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
    renderer = renderer_with(context, TOY)
    renderer.draw([still("p0")], camera_at(0, 0, 1))
    enable(0xFFFF)  # there is no such thing to enable
    with pytest.raises(GraphicsError, match="driver reports GL_INVALID_ENUM"):
        renderer.read_image()
    renderer.draw([still("p0")], camera_at(0, 0, 1))
    renderer.read_image()
