"""One head drawn on its own, and how far two drawings of it are apart.

Whatever shortens, quantises or conceals a latent, or saves triangles, is measured on pictures,
never by distances between latents. The error is MSE on 0-255 values over rasterised pixels, as in
the paper's tables; pixels that only one of the two drawings covers count too.
"""

from typing import NamedTuple

import moderngl
import numpy as np

from pica_client.decode.request import DecodedMaps
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement
from pica_core.avatar.file import Avatar
from pica_core.camera import Camera
from pica_core.types import BoolArray, FloatArray, Image

HEAD = np.eye(4, dtype=np.float32)
"""World from head of a head at rest in the origin."""
SLOT = "head"


class Drawing(NamedTuple):
    """What was drawn, from one view or from several."""

    image: Image
    """uint8 ``[..., H, W, 3]``."""
    covered: BoolArray
    """Where a head is. bool ``[..., H, W]``."""


class HeadRenderer:
    """One avatar on its own in a square image.

    Edges are not smoothed: that belongs to the display, and would hide errors of silhouettes.
    """

    def __init__(self, context: moderngl.Context, avatar: Avatar, size_px: int) -> None:
        self._renderer = Renderer(context, (size_px, size_px), RenderOptions(smooth_edges=False))
        self._renderer.add_avatar(SLOT, avatar)

    def draw(self, maps: DecodedMaps, camera: Camera, matrix: FloatArray = HEAD) -> Drawing:
        """Upload maps, draw the head at a pose and read the drawing back."""
        self._renderer.update_maps(SLOT, maps.position_map, maps.expression_map)
        self._renderer.draw([Placement(slot=SLOT, world_from_head=matrix)], camera)
        return read_drawing(self._renderer)


def read_drawing(renderer: Renderer) -> Drawing:
    """What a renderer drew last."""
    return Drawing(renderer.read_image(), renderer.read_surface()[2] >= 0)


def drawn_mse(a: Drawing, b: Drawing) -> float:
    """Mean squared error, 0-255, over the pixels that either drawing covers, all views together."""
    return masked_mse(a.image, b.image, a.covered | b.covered)


def masked_mse(a: Image, b: Image | FloatArray, where: BoolArray) -> float:
    """Mean squared error, 0-255, over some pixels; 0 if there are none."""
    return float(np.square(a[where].astype(np.float32) - b[where]).mean()) if where.any() else 0.0
