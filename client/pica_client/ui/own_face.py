"""One's own face while a call is shown: the picture in the corner, what the tracker sees beside it,
and what the user orders of it."""

from collections.abc import Callable

import moderngl
import numpy as np

from pica_client.publish.face_desk import FaceDesk
from pica_client.render.renderer import RenderOptions
from pica_client.ui.call_view import NOTHING, OwnFaceView
from pica_client.ui.controls import Order, OwnFace, UserOrder
from pica_client.ui.self_view import PERIOD_S, SelfView
from pica_client.ui.settings import OwnChoice
from pica_client.ui.surface.painter import Painter
from pica_core.types import Image


class OwnFaceCorner:
    """What the viewer has to do with a `FaceDesk`.

    Args:
        context: Where to draw; current on this thread.
        options: How avatars are drawn.
    """

    def __init__(self, context: moderngl.Context, desk: FaceDesk, options: RenderOptions) -> None:
        self._context = context
        self._desk = desk
        self._self_view = SelfView(context, desk.publisher.reflect(), options)
        self._camera: moderngl.Texture | None = None
        self._looked_s = -PERIOD_S
        self._shown = NOTHING

    def close(self) -> None:
        """End the decoding thread."""
        self._self_view.close()

    def tell(self, wanted: OwnFace) -> None:
        """Mute or freeze the face, or let it go on."""
        if wanted != "none":
            self._desk.publisher.mode = wanted

    def obey(self, order: UserOrder, now: float) -> None:
        """Do what is ordered, if it is of the face."""
        match order:
            case Order.CALIBRATE:
                self._desk.calibrate(now)
            case OwnChoice(source=source) if source:
                self._desk.choose(source)
            case _:
                pass

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
                has_tracker=seen is not None,
                has_face=seen is None or seen.has_face,
                bars=() if seen is None else seen.bars,
                camera=None if picture is None else self._upload(picture, painter),
                camera_aspect=1.0 if picture is None else picture.shape[1] / picture.shape[0],
            )
        return self._shown if height_px else NOTHING

    def _upload(self, picture: Image, painter: Painter) -> int:
        size = (picture.shape[1], picture.shape[0])
        if self._camera is None or self._camera.size != size:
            self._camera = self._context.texture(size, 3, alignment=1)
        self._camera.write(np.ascontiguousarray(picture), alignment=1)
        return painter.adopt("camera", self._camera)
