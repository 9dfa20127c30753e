"""One's own face while a call is shown: as the others see it, drawn small in a corner, and what the
tracker sees beside it."""

from collections.abc import Callable

import moderngl

from pica_client.call.reflection import SELF_ID, Reflection
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool, DecodePoolOptions
from pica_client.publish.face_desk import FaceDesk
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.seats import FreeShares
from pica_client.schedule.frame_planner import FramePlanner
from pica_client.schedule.scheduler import Scheduler
from pica_client.ui.avatar_presenter import AvatarPresenter
from pica_client.ui.call_view import NOTHING, OwnFaceView
from pica_client.ui.controls import ControlState
from pica_client.ui.surface.painter import Painter

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
        self._pool = DecodePool(DecodePoolOptions(), OnnxDecoder)
        self._presenter = AvatarPresenter(
            reflection.call, self._renderer, self._pool, FramePlanner(Scheduler())
        )

    def close(self) -> None:
        """End the decoding thread."""
        self._pool.close()

    def draw(self, now: float, height_px: int) -> moderngl.Texture | None:
        """One's own face on a picture so many pixels high; None before there is one."""
        size = (round(ASPECT * height_px), height_px)
        self._renderer.resize(size)
        scene = self._presenter.arrange(now, ControlState(layout="line"), size, FreeShares())
        self._presenter.decide(scene, (scene.camera,), BUDGET_S)
        self._presenter.collect(now)
        scene = self._presenter.dressed(scene)
        self._renderer.draw(scene.placements, scene.camera)
        if not self._presenter.num_decoded().get(SELF_ID):
            return None
        (texture,) = self._renderer.image.color_attachments
        assert isinstance(texture, moderngl.Texture)
        return texture


class OwnFaceCorner:
    """What there is to see of one's own face; see `SelfView`."""

    def __init__(self, context: moderngl.Context, desk: FaceDesk, options: RenderOptions) -> None:
        self._desk = desk
        self._self_view = SelfView(context, desk.publisher.reflect(), options)
        self._looked_s = -PERIOD_S
        self._shown = NOTHING

    def close(self) -> None:
        """End the decoding thread."""
        self._self_view.close()

    def draw(
        self, now: float, height_px: int, painter: Painter, say: Callable[[str, float], None]
    ) -> OwnFaceView:
        """What there is to show on a picture so many pixels high; what became of orders is said."""
        for notice in self._desk.take_notices(now):
            say(notice, now)
        if height_px and now - self._looked_s >= PERIOD_S:
            self._looked_s = now
            texture = self._self_view.draw(now, height_px)
            seen = self._desk.seen()
            picture = None if seen is None else seen.picture
            self._shown = OwnFaceView(
                texture=None if texture is None else painter.adopt("own face", texture),
                source=self._desk.source,
                seen=seen,
                camera=None if picture is None else painter.show("camera", picture),
            )
        return self._shown if height_px else NOTHING
