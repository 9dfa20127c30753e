"""One picture of one avatar, drawn like in a call: for lists of avatars, documents and a look after
training."""

import numpy as np
import numpy.typing as npt

from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, head_matrix, view_direction
from pica_client.render.seats import plan_seats
from pica_client.render.views import ViewState, plan_camera
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.gl import create_context
from pica_core.types import Image


def draw_thumbnail(
    avatar: Avatar,
    size: tuple[int, int] = (512, 512),
    *,
    arkit: npt.ArrayLike | None = None,
) -> Image:
    """Draw an avatar on its own, from straight ahead.

    Args:
        size: Columns and rows, pixels.
        arkit: Expression, ``[52]``; the neutral face by default.

    Returns:
        uint8 ``[H, W, 3]``, top row first.

    Raises:
        GraphicsError: No GL context; names the fix.
        ShaderError: The avatar cannot be drawn.
    """
    expression = np.zeros(NUM_ARKIT, np.float32) if arkit is None else arkit
    latent = ExpressionEncoder(avatar).encode(expression)
    plan = plan_seats("grid", 1, size[0] / size[1])
    camera = plan_camera(plan, ViewState(), *size)
    matrix = head_matrix(plan.seats[0], np.zeros(3), np.zeros(3))
    maps = OnnxDecoder(avatar).decode(latent, view_direction(matrix, camera.centre_m))
    context = create_context()
    try:
        renderer = Renderer(context, size, RenderOptions(fade_busts=True))
        renderer.add_avatar("avatar", avatar)
        renderer.update_maps("avatar", maps.position_map, maps.expression_map)
        renderer.draw([Placement(slot="avatar", world_from_head=matrix)], camera)
        return renderer.read_image()
    finally:
        context.release()
