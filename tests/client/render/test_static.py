"""What does not change with the face is drawn with a texture, and looks as if it were decoded."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest

from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.renderer import DrawStats, Renderer, RenderOptions
from pica_client.render.scene import Placement
from pica_core.avatar.file import Avatar, load_avatar, shipped_avatar_files
from pica_core.avatar.levels import STATIC_NAME
from pica_core.camera import look_at
from pica_core.types import Image

pytestmark = pytest.mark.render

SIZE = (240, 240)
AVATAR = load_avatar(shipped_avatar_files()[1])
DECODED = replace(AVATAR, tensors={k: a for k, a in AVATAR.tensors.items() if k != STATIC_NAME})
WHOLE = Placement(slot="head", world_from_head=np.eye(4, dtype=np.float32))
CAMERA = look_at(
    centre_m=(0.2, -0.05, 0.9),
    target_m=(0, -0.1, 0),
    vertical_fov=0.6,
    width=SIZE[0],
    height=SIZE[1],
)


def drawn(
    context: moderngl.Context, avatar: Avatar, level: int, placement: Placement = WHOLE
) -> tuple[Image, DrawStats]:
    """A moving face at a level."""
    with Renderer(context, SIZE, RenderOptions(smooth_edges=False)) as renderer:
        renderer.add_avatar("head", avatar)
        latent = np.random.default_rng(2).standard_normal((8, 8, 4)).astype(np.float32)
        maps = OnnxDecoder(avatar).decode(latent, np.array([0, 0, 1], np.float32), level)
        renderer.update_maps("head", maps.position_map, maps.expression_map)
        stats = renderer.draw([placement], CAMERA, count_pixels=True)
        return renderer.read_image(), stats


@pytest.mark.parametrize("level", AVATAR.levels)
def test_a_textured_pullover_looks_as_a_decoded_one(context: moderngl.Context, level: int) -> None:
    textured, stats = drawn(context, AVATAR, level)
    decoded, whole = drawn(context, DECODED, level)

    error = np.square(textured.astype(float) - decoded).mean(axis=2)
    assert error.mean() < 1.0
    assert np.percentile(error, 99.5) < 40
    assert stats.shaded_pixels is not None
    assert whole.shaded_pixels is not None
    assert stats.shaded_pixels < 0.5 * whole.shaded_pixels
    assert whole.textured_pixels == 0


def test_a_textured_pullover_does_not_flicker_as_its_wearer_moves(
    context: moderngl.Context,
) -> None:
    # Measured over 24 frames of talk: 2 to 11 % of the change, six heads at 65 and 120 cm.
    nodded = WHOLE.world_from_head.copy()
    nodded[:3, 3] = 0.004, 0.002, 0.0
    full = AVATAR.levels[-1]
    textured, decoded = (
        [
            drawn(context, avatar, full, placement)[0].astype(float)
            for placement in (WHOLE, replace(WHOLE, world_from_head=nodded))
        ]
        for avatar in (AVATAR, DECODED)
    )
    change = decoded[1] - decoded[0]
    flicker = textured[1] - textured[0] - change
    assert np.square(flicker).mean() < 0.15 * np.square(change).mean()
