"""Every variant of the Pixel Codec Avatar is drawn as numpy computes it."""

from __future__ import annotations

import moderngl
import numpy as np
import pytest

from helpers import tolerances
from helpers.toy import make_toy_avatar
from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, head_matrix
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import ENCODINGS, AvatarSpec
from pica_core.camera import look_at
from pica_core.reference import decode_pixels
from pica_core.sampling import sample_bilinear

pytestmark = pytest.mark.render

SIZE = (120, 96)
AVATARS = {
    name: make_toy_avatar(
        spec=AvatarSpec(
            encoding=name,
            uv_encoding_size=128,
            axis_encoding_size=300,
        ),
        grid=32,
    )
    for name in ENCODINGS
}


def drawn(
    context: moderngl.Context, avatar: Avatar, options: RenderOptions
) -> tuple[np.ndarray, Renderer, np.ndarray]:
    """An image, who drew it, and the expression map that it was drawn with."""
    latent = np.random.default_rng(5).standard_normal((8, 8, 4)).astype(np.float32)
    maps = OnnxDecoder(avatar).decode(latent, np.array([0, 0, 1], np.float32))
    renderer = Renderer(context, SIZE, options)
    renderer.add_avatar("p0", avatar)
    renderer.update_maps("p0", maps.position_map, maps.expression_map)
    camera = look_at(
        centre_m=(0.1, 0.02, 0.5),
        target_m=(0, 0, 0),
        vertical_fov=0.55,
        width=SIZE[0],
        height=SIZE[1],
    )
    seat = head_matrix(np.eye(4), [0, 0, 0], [0, 0, 0])
    renderer.draw([Placement(slot="p0", world_from_head=seat)], camera)
    return renderer.read_image(), renderer, maps.expression_map


@pytest.mark.parametrize("weights", ["block", "turns"])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_pixel_has_the_colour_that_numpy_computes(
    context: moderngl.Context, encoding: str, weights: str
) -> None:
    avatar = AVATARS[encoding]
    options = RenderOptions(
        weights=weights,  # type: ignore[arg-type]
        smooth_edges=False,
        filter_encodings=False,
    )
    image, renderer, expression_map = drawn(context, avatar, options)

    xyz_m, uv, heads = renderer.read_surface()
    covered = heads == 0
    codes = sample_bilinear(expression_map, uv[covered], np.float64)
    rgb = decode_pixels(avatar.spec, avatar.tensors, codes, xyz_m[covered], uv[covered], np.float64)

    wanted = np.clip(rgb, 0, 1) * 255
    assert covered.sum() > 1000
    assert np.abs(image[covered].astype(float) - wanted).max() <= 255 * tolerances.PIXEL_GLSL


@pytest.mark.parametrize("encoding", ["sinusoids", "axes"])
def test_what_a_pixel_cannot_resolve_is_averaged(context: moderngl.Context, encoding: str) -> None:
    avatar = AVATARS[encoding]
    plain, _, _ = drawn(context, avatar, RenderOptions(smooth_edges=False, filter_encodings=False))
    mean, _, _ = drawn(context, avatar, RenderOptions(smooth_edges=False))

    def roughness(image: np.ndarray) -> float:
        return float(np.abs(np.diff(image[20:70, 40:80].astype(float), axis=1)).mean())

    assert roughness(mean) < roughness(plain)
