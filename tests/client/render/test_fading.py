"""Busts pass softly into the room; the room is drawn anew only when it looks different."""

import moderngl
import numpy as np
import pytest

from pica_client.avatars.library import shipped_avatar_files
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.request import DecodedMaps
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.room import Room
from pica_client.render.scene import Placement
from pica_core.avatar.bust import CHIN_M, LOWEST_M, WHOLE_M, bust_of, fade_heights_m, seen_faces
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar, load_avatar
from pica_core.camera import Camera, look_at
from pica_core.types import Image

pytestmark = pytest.mark.render

SIZE = (160, 200)
SHARP = RenderOptions(smooth_edges=False)
FADING = RenderOptions(smooth_edges=False, fade_busts=True)
REST = Placement(slot="p", world_from_head=np.eye(4, dtype=np.float32))
ROOM = Room(seats_m=((0.0, 0.0, 0.0),), speaking=(0.0,))


def camera_at(
    yaw: float = 0.0, *, y_m: float = -0.06, away_m: float = 1.2, fov: float = 0.42
) -> Camera:
    return look_at(
        centre_m=np.array([away_m * np.sin(yaw), y_m, away_m * np.cos(yaw)]),
        target_m=np.array([0, y_m, 0]),
        vertical_fov=fov,
        width=SIZE[0],
        height=SIZE[1],
    )


@pytest.fixture(scope="module")
def person() -> tuple[Avatar, DecodedMaps]:
    avatar = load_avatar(shipped_avatar_files()[0])
    latent = ExpressionEncoder(avatar).encode(np.zeros(52, np.float32))
    return avatar, OnnxDecoder(avatar).decode(latent, np.array([0, 0, 1], np.float32), 64)


def with_person(
    context: moderngl.Context, person: tuple[Avatar, DecodedMaps], options: RenderOptions
) -> Renderer:
    renderer = Renderer(context, SIZE, options)
    renderer.add_avatar("p", person[0])
    renderer.update_maps("p", person[1].position_map, person[1].expression_map)
    return renderer


def picture(renderer: Renderer, *placements: Placement, camera: Camera | None = None) -> Image:
    renderer.draw(placements, camera or camera_at(), room=ROOM)
    return renderer.read_image()


def assert_fades(shown: Image, whole: Image, room: Image, covered: np.ndarray) -> None:
    """Above the chest nothing has changed; below, row by row, less and less is left of the bust."""
    middle = slice(SIZE[0] // 2 - 15, SIZE[0] // 2 + 15)
    np.testing.assert_array_equal(shown[:120, middle], whole[:120, middle])
    left, all_of_it = (
        np.abs(image[:, middle].astype(int) - room[:, middle]).mean(axis=(1, 2))
        for image in (shown, whole)
    )
    rows = [row for row in range(120, SIZE[1]) if covered[row, middle].all() and all_of_it[row] > 8]
    shares = left[rows] / all_of_it[rows]
    assert len(rows) > 20
    assert shares[0] > 0.95
    assert shares[-1] < 0.05
    assert (np.diff(shares) < 0.03).all()
    assert np.abs(np.diff(shares)).max() < 0.25  # no edge


def test_a_bust_is_whole_at_the_face_and_gone_at_its_lower_border(
    context: moderngl.Context, person: tuple[Avatar, DecodedMaps]
) -> None:
    plain = with_person(context, person, SHARP)
    whole = picture(plain, REST)
    covered = plain.read_surface()[2] >= 0
    room = picture(plain)
    assert_fades(picture(with_person(context, person, FADING), REST), whole, room, covered)


def test_where_nothing_is_left_of_a_bust_one_sees_who_is_behind(
    context: moderngl.Context, person: tuple[Avatar, DecodedMaps]
) -> None:
    renderer = with_person(context, person, FADING)
    renderer.add_placeholder("behind")
    pose = np.eye(4, dtype=np.float32)
    pose[:3, 3] = (0.0, -0.42, -0.3)
    behind = Placement(slot="behind", world_from_head=pose)
    camera = camera_at(y_m=-0.2, away_m=1.6, fov=0.5)
    below = slice(135, 170), slice(60, 100)
    alone = picture(renderer, behind, camera=camera)[below]
    assert np.abs(alone.astype(int) - picture(renderer, camera=camera)[below]).mean() > 10
    np.testing.assert_array_equal(picture(renderer, REST, behind, camera=camera)[below], alone)


def test_of_neighbours_who_fade_at_one_height_the_nearer_one_is_seen(
    context: moderngl.Context, person: tuple[Avatar, DecodedMaps]
) -> None:
    renderer = with_person(context, person, FADING)
    renderer.add_avatar("behind", person[0])
    renderer.update_maps("behind", person[1].position_map, person[1].expression_map)
    pose = np.eye(4, dtype=np.float32)
    pose[:3, 3] = (0.08, 0.0, -0.1)
    behind = Placement(slot="behind", world_from_head=pose)
    picture(renderer, REST)
    surface_m, _, head = renderer.read_surface()
    fading = (head == 0) & (surface_m[..., 1] < fade_heights_m(bust_of(person[0]).lower_m)[1])
    picture(renderer, REST, behind)
    assert (renderer.read_surface()[2][fading] == 0).all()


def test_a_room_is_drawn_anew_only_when_it_looks_different(context: moderngl.Context) -> None:
    renderer = Renderer(context, SIZE, SHARP)
    first = picture(renderer)
    np.testing.assert_array_equal(picture(renderer), first)
    turned = picture(renderer, camera=camera_at(0.4))
    assert (turned != first).any()
    np.testing.assert_array_equal(picture(renderer), first)
    renderer.draw([], camera_at(), room=Room(seats_m=ROOM.seats_m, speaking=(1.0,)))
    ring = renderer.read_image().astype(int) - first
    assert ring[..., 1].max() > 20  # a green ring
    assert ring[..., 1].max() > ring[..., 0].max()


@pytest.mark.parametrize("lower_m", [-5.0, -0.27, -0.15, -0.1, 0.0])
def test_no_bust_is_so_short_that_the_face_fades(lower_m: float) -> None:
    gone, whole = fade_heights_m(lower_m)
    assert max(lower_m, LOWEST_M) <= gone < whole
    assert whole <= max(CHIN_M, gone + 0.01)
    assert WHOLE_M[1] < gone


def test_a_mesh_that_lies_below_where_busts_fade_is_drawn_whole() -> None:
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    vertices_m = np.zeros((4, 3), np.float32)
    vertices_m[3, 1] = 1.0

    assert seen_faces(faces, vertices_m, 0.5).tolist() == [[0, 2, 3]]
    assert seen_faces(faces, vertices_m, 2.0).tolist() == faces.tolist()
