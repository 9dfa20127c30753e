"""One's own face as the others see it, drawn small: for the corner of the picture."""

from contextlib import ExitStack

import moderngl

from pica_client.call.reflection import SELF_ID, Reflection
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.schedule.frame_planner import FramePlanner
from pica_client.schedule.scheduler import Scheduler
from pica_client.ui.avatar_presenter import AvatarPresenter, Seating

ASPECT = 4 / 3
PERIOD_S = 1 / 15
"""Between two images (chosen: one's own face is to be checked, not watched)."""
BUDGET_S = 0.01
"""What one image may take."""


class SelfView:
    """Decodes and draws a reflection, beside the call, into a texture of its own.

    Args:
        context: Where to draw; current on this thread.
        options: How avatars are drawn.
    """

    def __init__(
        self, context: moderngl.Context, reflection: Reflection, options: RenderOptions
    ) -> None:
        self._renderer = Renderer(context, (16, 12), options)
        with ExitStack() as stack:
            self._pool = stack.enter_context(DecodePool(OnnxDecoder))
            self._resources = stack.pop_all()
        self._presenter = AvatarPresenter(
            reflection.call, self._renderer, self._pool, FramePlanner(Scheduler())
        )

    def close(self) -> None:
        """End the decoding thread."""
        self._resources.close()

    def draw(self, now: float, height_px: int) -> moderngl.Texture | None:
        """One's own face on a picture so many pixels high; None before there is one."""
        size = (round(ASPECT * height_px), height_px)
        if size != self._renderer.size:
            self._renderer.resize(size)
        scene = self._presenter.arrange(now, Seating(layout="line"), size)
        self._presenter.decide(scene, (scene.camera,), BUDGET_S)
        self._presenter.collect(now)
        scene = self._presenter.dressed(scene)
        self._renderer.draw(scene.placements, scene.camera)
        if not self._presenter.num_decoded().get(SELF_ID):
            return None
        (texture,) = self._renderer.image.color_attachments
        assert isinstance(texture, moderngl.Texture)
        return texture
