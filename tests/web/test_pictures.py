"""The page decodes and draws as the Python client does: in a headless Chromium by SwiftShader."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
import pytest

from helpers.browser import run_page
from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.room import Room
from pica_client.render.scene import Placement, head_matrix, view_direction
from pica_client.render.seats import plan_seats
from pica_client.render.views import ViewState, orbit_limits, plan_camera
from pica_client.sources.source import make_performance
from pica_core.avatar.bust import bust_of
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar, shipped_avatar_files
from pica_core.gl import create_context
from pica_core.reference import decode_expression_map, decode_position_map
from pica_core.types import LATENT_SHAPE, Image

pytestmark = pytest.mark.render
AVATARS = {path.stem: path for path in shipped_avatar_files()}


@pytest.fixture(scope="module")
def context() -> Iterator[moderngl.Context]:
    made = create_context()
    yield made
    made.release()


@pytest.mark.parametrize(
    ("only_halfs", "codes_off", "positions_off_m"), [(False, 1e-6, 1e-7), (True, 4e-3, 3e-4)]
)
def test_maps_are_those_of_numpy(
    only_halfs: bool, codes_off: float, positions_off_m: float
) -> None:
    rng = np.random.default_rng(5)
    names, levels = list(AVATARS)[:3], [256, 64, 128]
    files, expected = {}, []
    for name, level in zip(names, levels, strict=True):
        avatar = load_avatar(AVATARS[name])
        latent = rng.normal(0, 0.6, LATENT_SHAPE).astype(np.float32)
        view = rng.normal(0, 0.2, 3).astype(np.float32) + np.float32([0, 0, 1])
        view /= np.linalg.norm(view)
        files[f"{name}.pica"] = AVATARS[name].read_bytes()
        files[f"{name}.latent"] = np.concatenate([latent.ravel(), view]).tobytes()
        used = avatar.sheet_vertices(level)
        assert used is not None
        positions = decode_position_map(avatar, latent, level=level).reshape(-1, 3)[: len(used)]
        codes = decode_expression_map(avatar, latent, view, level=level).reshape(-1, 4)
        expected.append((positions, codes))
    case = {"names": names, "levels": levels, "onlyHalfs": only_halfs}
    posted, found = run_page("decode.html", {**files, "case.json": json.dumps(case).encode()})
    assert found["glError"] == 0
    for number, (positions, codes) in enumerate(expected):
        drawn = np.frombuffer(posted[f"/positions%20{number}"], np.float32).reshape(-1, 4)
        assert np.abs(drawn[: len(positions), :3] - positions).max() < positions_off_m
        drawn = np.frombuffer(posted[f"/codes%20{number}"], np.float32).reshape(-1, 4)
        assert np.abs(drawn - codes).max() < codes_off


@dataclass(frozen=True, kw_only=True)
class _Case:
    """People at one moment, and the picture that the Python client makes of them."""

    files: dict[str, bytes]
    image: Image


def _talking(
    context: moderngl.Context,
    names: Sequence[str],
    size: tuple[int, int],
    levels: Sequence[int],
    **options: Any,
) -> _Case:
    """Shipped people who talk, drawn by the renderer of the viewer."""
    avatars = [load_avatar(AVATARS[name]) for name in names]
    shoulders_m = max(bust_of(avatar).width_m for avatar in avatars)
    plan = plan_seats("line", len(names), size[0] / size[1], shoulders_m=shoulders_m)
    limits = orbit_limits(plan, tuple(avatar.manifest.view_span for avatar in avatars))
    camera = plan_camera(plan, ViewState(), *size, limits)
    speaking = [1.0 if index == 0 else 0.0 for index in range(len(names))]
    room = Room(seats_m=plan.places_m, speaking=tuple(speaking))
    heads, latents, placements = [], [], []
    with Renderer(context, size, RenderOptions(fade_busts=True)) as renderer:
        for index, (avatar, level) in enumerate(zip(avatars, levels, strict=True)):
            face = make_performance("talk", seed=index, start_s=2.3 * index).frame_at(1.0)
            latent = ExpressionEncoder(avatar).encode(face.arkit)
            matrix = head_matrix(plan.seats[index], face.rotation, face.translation_m)
            renderer.add_avatar(str(index), avatar)
            towards = view_direction(matrix, camera.centre_m)
            maps = OnnxDecoder(avatar).decode(latent, towards, level, "both")
            renderer.update_maps(str(index), maps.position_map, maps.expression_map)
            placements.append(Placement(slot=str(index), world_from_head=matrix))
            latents.append(latent.ravel())
            pose = {"rotation": face.rotation.tolist(), "translation": face.translation_m.tolist()}
            heads.append({"name": names[index], **pose, "fade": 0, "level": level})
        renderer.draw(placements, camera, room=room)
        image = renderer.read_image().copy()
    case = {"heads": heads, "size": size, "layout": "line", "speaking": speaking, **options}
    files = {f"{name}.pica": AVATARS[name].read_bytes() for name in names}
    files["latents"] = np.concatenate(latents).astype(np.float32).tobytes()
    return _Case(files={**files, "case.json": json.dumps(case).encode()}, image=image)


def _image(data: bytes, size: tuple[int, int]) -> Image:
    """What a page read from its canvas, top row first, ``[H, W, 4]``."""
    return np.frombuffer(data, np.uint8).reshape(size[1], size[0], 4)[::-1]


@pytest.mark.parametrize(("count", "only_halfs"), [(1, False), (5, False), (1, True)])
def test_a_picture_is_that_of_the_viewer(
    context: moderngl.Context, count: int, only_halfs: bool
) -> None:
    size, levels = (960, 540), [256, 128, 64, 256, 128][:count]
    case = _talking(context, list(AVATARS)[:count], size, levels, onlyHalfs=only_halfs)
    posted, found = run_page("draw.html", case.files)
    image = _image(posted["/image"], size)
    assert found["glError"] == 0
    assert found["numDrawn"] == count
    apart = np.abs(image[..., :3].astype(int) - case.image)
    assert apart.mean() < 0.5  # 0.05 to 0.08 here; 3 is what was promised
    assert (image[..., 3] == 255).all()
