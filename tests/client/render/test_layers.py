"""Only heads that changed are drawn again, and the image is the one that is drawn as a whole."""

from collections.abc import Iterator

import moderngl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.room import Room
from pica_client.render.scene import Placement, head_matrix
from pica_core.avatar.bust import outline_of
from pica_core.avatar.spec import AvatarSpec
from pica_core.camera import Camera, look_at
from pica_core.gl import create_context

pytestmark = pytest.mark.render

TOY = with_toy_levels(make_toy_avatar(spec=AvatarSpec(uv_encoding_size=64), grid=40))
SIZE = (240, 100)
PEOPLE = ("p0", "p1", "p2")
ROOM = Room(seats_m=((-0.2, 0, 0), (0, 0, 0), (0.2, 0, 0)), speaking=(0, 0, 0))


def camera(size: tuple[int, int], x_m: float = 0.0) -> Camera:
    return look_at(
        centre_m=(x_m, 0.05, 1.1),
        target_m=(0, 0, 0),
        vertical_fov=0.5,
        width=size[0],
        height=size[1],
    )


class Stage:
    """People side by side, near enough to overlap, and a renderer that never keeps anything."""

    def __init__(self, context: moderngl.Context) -> None:
        options = RenderOptions(fade_busts=True)
        self.kept, self.fresh = (Renderer(context, SIZE, options) for _ in range(2))
        self.people = list(PEOPLE)
        self.turn = dict.fromkeys(PEOPLE, 0.0)
        self.fade = 0.0
        self.room, self.camera = ROOM, camera(SIZE)
        decoder = OnnxDecoder(TOY)
        rng = np.random.default_rng(3)
        self.faces = []
        for level in (TOY.levels[-1], TOY.levels[-1], TOY.levels[0]):
            latent = rng.standard_normal((8, 8, 4)).astype(np.float32)
            found = decoder.decode(latent, np.array([0, 0, 1], np.float32), level)
            self.faces.append((found.position_map, found.expression_map))
        for slot in PEOPLE:
            self.add(slot)

    def add(self, slot: str) -> None:
        for renderer in (self.kept, self.fresh):
            renderer.add_avatar(slot, TOY)
        self.show(slot, 0)

    def show(self, slot: str, face: int) -> None:
        for renderer in (self.kept, self.fresh):
            renderer.update_maps(slot, *self.faces[face])

    def drawn(self) -> list[str]:
        """Draw with both, compare, and say of whom the first drew something."""
        placements = [
            Placement(
                slot=slot,
                world_from_head=head_matrix(
                    np.eye(4), [0, self.turn[slot], 0], [0.2 * PEOPLE.index(slot) - 0.2, 0, 0]
                ),
                fade=self.fade,
            )
            for slot in self.people
        ]
        self.fresh.forget_frame()
        self.fresh.draw(placements, self.camera, room=self.room)
        stats = self.kept.draw(placements, self.camera, room=self.room)
        np.testing.assert_array_equal(self.kept.read_image(), self.fresh.read_image())
        return list(stats.drawn)


@pytest.fixture
def stage() -> Iterator[Stage]:
    context = create_context()
    made = Stage(context)
    assert made.drawn() == list(PEOPLE)
    yield made
    made.kept.close()
    made.fresh.close()
    context.release()


@pytest.mark.parametrize("face", [1, 2])
def test_a_new_face_is_drawn_alone_however_near_others_are(stage: Stage, face: int) -> None:
    stage.show("p0", face)
    assert stage.drawn() == ["p0"]
    assert stage.drawn() == []


def test_a_head_that_turns_leaves_nothing_behind(stage: Stage) -> None:
    for angle in (0.4, -0.6):
        stage.turn["p2"] = angle
        assert stage.drawn() == ["p2"]


def test_who_comes_and_goes_is_drawn_and_wiped_out(stage: Stage) -> None:
    stage.people.remove("p1")
    assert stage.drawn() == []
    stage.people = list(PEOPLE)
    assert stage.drawn() == ["p1"]


def test_another_avatar_in_the_same_slot_is_drawn(stage: Stage) -> None:
    stage.add("p1")
    assert stage.drawn() == ["p1"]


def test_who_fades_is_not_drawn_again(stage: Stage) -> None:
    stage.fade = 0.5
    assert stage.drawn() == []


def test_another_room_is_seen_behind_heads_that_are_kept(stage: Stage) -> None:
    stage.room = Room(seats_m=ROOM.seats_m, speaking=(0, 1, 0))
    assert stage.drawn() == []
    stage.room = ROOM
    assert stage.drawn() == []


def test_from_another_camera_or_at_another_size_all_are_drawn(stage: Stage) -> None:
    stage.camera = camera(SIZE, 0.1)
    assert stage.drawn() == list(PEOPLE)
    size = (200, 90)
    for renderer in (stage.kept, stage.fresh):
        renderer.resize(size)
    stage.camera = camera(size, 0.1)
    assert stage.drawn() == list(PEOPLE)
    assert stage.drawn() == []


def test_what_others_paint_over_an_image_does_not_stay(stage: Stage) -> None:
    before = stage.kept.read_image().copy()
    stage.kept.image.clear(1, 0, 0, 1)
    stage.drawn()
    np.testing.assert_array_equal(stage.kept.read_image(), before)


@pytest.mark.parametrize("scale", [0.75, 0.5])
def test_a_head_of_lower_resolution_is_enlarged_to_where_it_was(stage: Stage, scale: float) -> None:
    renderer, size = stage.kept, (480, 200)
    renderer.resize(size)
    images, covered = [], []
    for share in (1.0, scale):
        rest = Placement(slot="p0", world_from_head=np.eye(4, dtype=np.float32), scale=share)
        stats = renderer.draw([rest], camera(size), room=ROOM, count_pixels=True)
        covered.append(renderer.read_surface()[2] == 0)
        images.append(renderer.read_image().astype(int))
    assert stats.shaded_pixels == pytest.approx(scale**2 * covered[0].sum(), rel=0.03)
    assert (covered[0] != covered[1]).mean() < 0.01
    assert np.abs(images[0] - images[1]).mean() < 1


@given(st.integers(0, 2**32 - 1), st.floats(0, 0.03))
def test_an_outline_holds_vertices_wherever_they_go(seed: int, slack_m: float) -> None:
    rng = np.random.default_rng(seed)
    vertices_m = rng.normal(size=(200, 3)) * (0.1, 0.15, 0.08)
    aside = rng.normal(size=3)
    aside /= np.linalg.norm(aside)
    outline_m = outline_of(vertices_m.astype(np.float32), slack_m)
    reach_m = float((outline_m @ aside).max() - (vertices_m @ aside).max())
    assert reach_m > 0.9 * slack_m - 0.001
