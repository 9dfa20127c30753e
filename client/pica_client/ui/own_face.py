"""The user's own face while a call is shown: as the others see it, drawn small in a corner, and
what the tracker sees beside it."""

import moderngl

from pica_client.call.reflection import Reflection
from pica_client.call.roster import SELF_ID
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool
from pica_client.publish.face_controls import FaceControls
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.schedule.scheduler import Scheduler
from pica_client.ui.avatar_presenter import AvatarPresenter
from pica_client.ui.call_view import OwnFaceView
from pica_client.ui.panels.overlay import ASPECT
from pica_client.ui.state import ViewState
from pica_client.ui.surface.surface import Surface

PERIOD_S = 1 / 15
"""Between two images (chosen: the own face is to be checked, not watched)."""
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
        self._presenter = AvatarPresenter(reflection.call, self._renderer, self._pool, Scheduler())
        self._looked_s = -PERIOD_S
        self._shown = OwnFaceView()

    def close(self) -> None:
        """End the decoding thread."""
        self._pool.close()

    def draw(self, now: float, height_px: int) -> moderngl.Texture | None:
        """Draw the own face so many pixels high; None before there is one."""
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

    def look(
        self, now: float, height_px: int, controls: FaceControls, surface: Surface
    ) -> OwnFaceView:
        """Return what there is to see on a picture so many pixels high, renewed each `PERIOD_S`."""
        if height_px and now - self._looked_s >= PERIOD_S:
            self._looked_s = now
            texture, seen = self.draw(now, height_px), controls.preview()
            picture = None if seen is None else seen.picture
            self._shown = OwnFaceView(
                texture=None if texture is None else surface.adopt("own face", texture),
                source=controls.source,
                seen=seen,
                camera=None if picture is None else surface.show("camera", picture),
            )
        return self._shown if height_px else OwnFaceView()
