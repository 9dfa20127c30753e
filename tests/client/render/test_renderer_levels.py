"""Levels, eyes and textured heads, as the renderer draws them."""

import gc
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from helpers import tolerances
from helpers.painted import painted_head
from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.gpu_avatar import axis_table
from pica_client.render.gpu_program import axis_levels
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, head_matrix
from pica_core.avatar.levels import STILL_NAME
from pica_core.avatar.spec import AvatarSpec
from pica_core.camera import Camera, look_at
from pica_core.errors import ShapeError
from pica_core.reference import decode_pixels
from pica_core.sampling import sample_bilinear

pytestmark = pytest.mark.render

SIZE = (160, 120)
TOY = with_toy_levels(make_toy_avatar(spec=AvatarSpec(uv_encoding_size=256), grid=40))
SHARP = RenderOptions(smooth_edges=False)
UNFILTERED = RenderOptions(smooth_edges=False, filter_encodings=False)
FRONT = np.array([0, 0, 1], np.float32)


@pytest.fixture(scope="module")
def maps() -> dict[int, tuple[np.ndarray, np.ndarray]]:
    latent = np.random.default_rng(5).standard_normal((8, 8, 4)).astype(np.float32)
    decoder = OnnxDecoder(TOY)
    found = {}
    for level in TOY.levels:
        decoded = decoder.decode(latent, FRONT, level)
        found[level] = (decoded.position_map, decoded.expression_map)
    return found


Maps = dict[int, tuple[np.ndarray, np.ndarray]]


def camera_at(*centre_m: float, size: tuple[int, int] = SIZE) -> Camera:
    return look_at(
        centre_m=centre_m, target_m=(0, 0, 0), vertical_fov=0.55, width=size[0], height=size[1]
    )


NEAR = camera_at(0.1, 0.05, 0.7)


def placed(slot: str = "p0", x: float = 0, z: float = 0, **choices: object) -> Placement:
    matrix = head_matrix(np.eye(4), [0, 0, 0], [x, 0, z])
    return replace(Placement(slot=slot, world_from_head=matrix), **choices)  # type: ignore[arg-type]


def renderer_with(
    context: moderngl.Context,
    maps: Maps,
    *levels: int,
    options: RenderOptions = SHARP,
    size: tuple[int, int] = SIZE,
) -> Renderer:
    """A renderer with one head, to which maps of these levels came one after another."""
    renderer = Renderer(context, size, options)
    renderer.add_avatar("p0", TOY)
    for level in levels:
        renderer.update_maps("p0", *maps[level])
    return renderer


def drawn(renderer: Renderer, placement: Placement, camera: Camera = NEAR) -> np.ndarray:
    renderer.draw([placement], camera)
    return renderer.read_image().astype(np.float32)


def gpu_objects() -> set[int]:
    kinds = (moderngl.Texture, moderngl.Buffer, moderngl.Framebuffer, moderngl.VertexArray)
    return {id(item) for item in gc.get_objects() if type(item) in (*kinds, moderngl.Query)}


@pytest.mark.parametrize("level", TOY.levels)
def test_a_level_is_drawn_with_its_own_mesh(
    context: moderngl.Context, maps: Maps, level: int
) -> None:
    renderer = renderer_with(context, maps, level)
    stats = renderer.draw([placed()], NEAR, count_pixels=True)
    assert stats.num_triangles == len(TOY.level_faces(level))
    assert stats.shaded_pixels == (renderer.read_surface()[2] == 0).sum()


def test_a_coarse_map_is_added_to_the_still_one(context: moderngl.Context, maps: Maps) -> None:
    latent = np.random.default_rng(6).standard_normal((8, 8, 4)).astype(np.float32)
    moved = replace(TOY, tensors=TOY.tensors | {STILL_NAME: latent})
    renderer = Renderer(context, SIZE, UNFILTERED)
    renderer.add_avatar("p0", moved)
    renderer.update_maps("p0", maps[64][0], np.full((64, 64, 4), 0.3, np.float32))
    image = drawn(renderer, placed())
    xyz_m, uv, heads = renderer.read_surface()
    own = heads == 0
    still = OnnxDecoder(TOY).decode(latent, FRONT).expression_map
    codes = sample_bilinear(still, uv[own], np.float64) + 0.3
    rgb = decode_pixels(TOY.spec, TOY.tensors, codes, xyz_m[own], uv[own], np.float64)
    assert np.abs(image[own] - 255 * np.clip(rgb, 0, 1)).max() <= 255 * tolerances.PIXEL_GLSL


def test_a_map_that_does_not_come_stays(context: moderngl.Context, maps: Maps) -> None:
    both = renderer_with(context, maps, 256)
    apart = renderer_with(context, maps)
    apart.update_maps("p0", maps[256][0], None)
    assert apart.draw([placed()], NEAR).num_placeholders == 1
    apart.update_maps("p0", None, maps[256][1])
    np.testing.assert_array_equal(drawn(both, placed()), drawn(apart, placed()))


@pytest.mark.parametrize("level", TOY.levels[:-1])
def test_a_sheet_puts_every_vertex_where_the_decoder_has_it(
    context: moderngl.Context, maps: Maps, level: int
) -> None:
    used = np.unique(TOY.level_faces(level))
    vertices_m = maps[level][0].reshape(-1, 3)[: len(used)]
    renderer = renderer_with(context, maps, level)
    renderer.draw([placed()], NEAR)
    xyz_m, uv, heads = renderer.read_surface()
    own = heads == 0
    apart = uv[own][::97, None] - TOY.tensors["mesh.vertex_uv"][used]
    nearest = np.square(apart).sum(axis=2).argmin(axis=1)
    away_m = np.linalg.norm(xyz_m[own][::97] - vertices_m[nearest], axis=1)
    # A corner of the triangle is near, in the chart as in the head (in another order: 0.12).
    assert np.median(away_m) < 0.03


def test_a_refused_map_changes_nothing(context: moderngl.Context, maps: Maps) -> None:
    renderer = renderer_with(context, maps, 256)
    before = drawn(renderer, placed())
    with pytest.raises(ShapeError, match=r"\(32, 32, 4\); float32 \(64, 64, 4\), "):
        renderer.update_maps("p0", maps[64][0], np.zeros((32, 32, 4), np.float32))
    with pytest.raises(ShapeError, match="float64"):
        renderer.update_maps("p0", maps[64][0].astype(np.float64), None)
    np.testing.assert_array_equal(drawn(renderer, placed()), before)


@pytest.mark.parametrize("size", [(160, 120), (161, 119)])
def test_an_eye_sees_what_one_camera_would(
    context: moderngl.Context, maps: Maps, size: tuple[int, int]
) -> None:
    half = (size[0] // 2, size[1])
    rest = (size[0] - half[0], size[1])
    eyes = (camera_at(-0.03, 0, 0.6, size=half), camera_at(0.03, 0, 0.6, size=rest))
    stereo = renderer_with(context, maps, 256, size=size)
    stats = stereo.draw([placed()], *eyes, count_pixels=True)
    image, heads = stereo.read_image(), stereo.read_surface()[2]
    assert stats.drawn == ("p0", "p0")
    assert stats.shaded_pixels == (heads >= 0).sum()
    for camera, part, width in (
        (eyes[0], image[:, : half[0]], half),
        (eyes[1], image[:, half[0] :], rest),
    ):
        alone = renderer_with(context, maps, 256, size=width)
        difference = np.abs(drawn(alone, placed(), camera) - part)
        # Window coordinates of the right eye are rounded elsewhere: a pixel at an edge may differ.
        assert (difference > 2).any(axis=-1).mean() < 0.005


@pytest.mark.parametrize("num_eyes", [1, 2])
def test_after_the_first_frames_nothing_is_made_whatever_changes(
    context: moderngl.Context, maps: Maps, num_eyes: int
) -> None:
    renderer = renderer_with(context, maps, 128, 64, 256, options=RenderOptions())
    size = (160 // num_eyes, 120)
    eyes = [camera_at(0.03 * number, 0, 0.6, size=size) for number in range(num_eyes)]
    renderer.draw([placed()], *eyes, count_pixels=True)
    before = gpu_objects()
    for index in range(12):
        renderer.update_maps("p0", *maps[TOY.levels[index % 3]])
        renderer.draw([placed()], *eyes, count_pixels=True)
    assert gpu_objects() == before


@pytest.mark.parametrize("count", [1, 2, 100, 128, 1000])
def test_levels_of_a_table_are_means_of_twice_as_many_entries(count: int) -> None:
    table = np.random.default_rng(1).standard_normal((count, 2)).astype(np.float32)
    texels = axis_table(table)
    stride = len(texels) // 2
    np.testing.assert_allclose(texels[:count, :2], table, atol=1e-6)
    np.testing.assert_allclose(texels[: count - 1, 2:], np.diff(table, axis=0), atol=1e-6)
    for level in range(axis_levels(count)):
        start, wide = 2 * stride - (2 * stride >> level), 1 << level
        for entry in range(-(-count // wide)):
            mean = table[entry * wide : (entry + 1) * wide].mean(axis=0)
            np.testing.assert_allclose(texels[start + entry, :2], mean, atol=1e-6)
        np.testing.assert_array_equal(texels[start + -(-count // wide) - 1, 2:], 0)


def test_far_heads_average_what_their_pixels_cover(context: moderngl.Context, maps: Maps) -> None:
    far = camera_at(0.1, 0.05, 6.0)
    truth = renderer_with(context, maps, 256, size=(1280, 960), options=UNFILTERED)
    fine = drawn(truth, placed(), far.scaled(1280, 960)).reshape(120, 8, 160, 8, 3).mean((1, 3))
    whole = (truth.read_surface()[2] >= 0).reshape(120, 8, 160, 8).all(axis=(1, 3))
    errors = [
        np.square(drawn(renderer_with(context, maps, 256, options=options), placed(), far) - fine)[
            whole
        ].mean()
        for options in (SHARP, UNFILTERED)
    ]
    assert errors[0] < 0.6 * errors[1]


def test_a_textured_head_shows_its_texture_where_the_other_kind_would_be(
    context: moderngl.Context, maps: Maps
) -> None:
    renderer = renderer_with(context, maps, 256)
    mesh = painted_head(
        vertex_uv=TOY.tensors["mesh.vertex_uv"],
        faces=TOY.tensors["mesh.faces"],
        low_m=TOY.manifest.bounds_min_m,
        high_m=TOY.manifest.bounds_max_m,
        texture_size=64,
    )
    renderer.add_textured("painted", mesh)
    assert renderer.draw([placed("painted")], NEAR).num_placeholders == 1
    texel = (np.arange(64, dtype=np.float32) + 0.5) / 64
    u, v = np.meshgrid(texel, texel)
    colours = np.stack([u, v, np.full_like(u, 0.5)], axis=-1)  # they say where they are
    renderer.update_textured("painted", TOY.mean_vertices_m, colours)
    renderer.update_maps("p0", TOY.tensors["linear.mean"], None)
    renderer.draw([placed()], NEAR)
    _, uv, heads = renderer.read_surface()
    stats = renderer.draw([placed("painted")], NEAR, count_pixels=True)
    image = renderer.read_image() / 255
    inside = (heads == 0) & (uv > 0.02).all(axis=-1) & (uv < 0.98).all(axis=-1)
    assert inside.sum() > 2000
    np.testing.assert_allclose(image[inside][:, :2], uv[inside], atol=0.012)
    assert stats.num_avatars == 1
    assert stats.textured_pixels == pytest.approx((heads == 0).sum(), rel=0.05)
