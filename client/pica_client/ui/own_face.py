"""One's own face while a call is shown: as the others see it, drawn small in a corner, and what the
tracker sees beside it."""

import moderngl

from pica_client.call.reflection import SELF_ID, Reflection
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool
from pica_client.publish.face_desk import FaceDesk
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.schedule.frame_planner import FramePlanner
from pica_client.schedule.scheduler import Scheduler
from pica_client.ui.avatar_presenter import AvatarPresenter
from pica_client.ui.call_view import NOTHING, OwnFaceView
from pica_client.ui.state import ViewState
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
        self._pool = DecodePool(OnnxDecoder)
        self._presenter = AvatarPresenter(
            reflection.call, self._renderer, self._pool, FramePlanner(Scheduler())
        )
        self._looked_s = -PERIOD_S
        self._shown = NOTHING

    def close(self) -> None:
        """End the decoding thread."""
        self._pool.close()

    def draw(self, now: float, height_px: int) -> moderngl.Texture | None:
        """One's own face on a picture so many pixels high; None before there is one."""
        size = (round(ASPECT * height_px), height_px)
        self._renderer.resize(size)
        scene = self._presenter.arrange(now, size, ViewState(layout="line"))
        self._presenter.decide(scene, (scene.camera,), BUDGET_S)
        self._presenter.collect(now)
        scene = self._presenter.dressed(scene)
        self._renderer.draw(scene.placements, scene.camera)
        if not self._presenter.num_decoded().get(SELF_ID):
            return None
        (texture,) = self._renderer.image.color_attachments
        assert isinstance(texture, moderngl.Texture)
        return texture

    def look(self, now: float, height_px: int, desk: FaceDesk, painter: Painter) -> OwnFaceView:
        """What there is to see on a picture so many pixels high, every `PERIOD_S` anew."""
        if height_px and now - self._looked_s >= PERIOD_S:
            self._looked_s = now
            texture, seen = self.draw(now, height_px), desk.seen()
            picture = None if seen is None else seen.picture
            self._shown = OwnFaceView(
                texture=None if texture is None else painter.adopt("own face", texture),
                source=desk.source,
                seen=seen,
                camera=None if picture is None else painter.show("camera", picture),
            )
        return self._shown if height_px else NOTHING
