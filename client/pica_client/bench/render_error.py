"""What a change of the latent does to the picture: one head drawn from fixed views, and the error
between two such drawings.

Everything that shortens, quantises or conceals a latent is judged by this, never by distances
between latents. The error is MSE on 0-255 values over rasterised pixels, as in the paper's tables;
pixels that only one of the two drawings covers count too.

    with FaceRenderer(avatar) as renderer:
        error = rendered_mse(renderer.draw(latent), renderer.draw(coded))
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np
import numpy.typing as npt

from pica_client.decode.decoder import ObjectDecoder, OnnxDecoder
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, head_matrix, view_direction
from pica_core.avatar.file import Avatar
from pica_core.camera import Camera
from pica_core.capture.stage.dome import EVALUATION_VIEWS, dome_cameras
from pica_core.errors import ShapeError
from pica_core.gl import create_context
from pica_core.types import FloatArray, Image

PEAK = 255.0
_NO_POSE = np.zeros(3, np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """One face from every view of a `FaceRenderer`."""

    images: Image
    """uint8 ``[views, H, W, 3]``."""
    covered: npt.NDArray[np.bool_]
    """Where the head is. bool ``[views, H, W]``."""


class FaceRenderer:
    """Draws one avatar through the real decoder and renderer; belongs to one thread.

    Args:
        avatar: Checked avatar.
        size_px: Rows and columns of each image.
        views: Names among the stage's evaluation views; by default the front and the left.
        decoder: Its decoder, if there is one already.

    Raises:
        GraphicsError: No GL context; names the fix.
    """

    def __init__(
        self,
        avatar: Avatar,
        *,
        size_px: int = 256,
        views: Sequence[str] = ("front", "left"),
        decoder: ObjectDecoder | None = None,
    ) -> None:
        self.cameras = evaluation_cameras(views, size_px)
        self._decoder = decoder or OnnxDecoder(avatar)
        self._context = create_context()
        # Smoothed edges would hide errors of the silhouette and belong to the display, not to us.
        options = RenderOptions(smooth_edges=False)
        self._renderer = Renderer(self._context, (size_px, size_px), options)
        self._renderer.add_avatar("face", avatar)

    def draw(
        self,
        latent: FloatArray,
        rotation: npt.ArrayLike = _NO_POSE,
        translation_m: npt.ArrayLike = _NO_POSE,
    ) -> Drawing:
        """Draw a face.

        Args:
            latent: float32 ``[8, 8, 4]``.
            rotation: Head pose, rotation vector in radians ``[3]``.
            translation_m: Head offset, metres ``[3]``.
        """
        matrix = head_matrix(np.eye(4), rotation, translation_m)
        images, covered = [], []
        for camera in self.cameras:
            maps = self._decoder.decode(latent, view_direction(matrix, camera.centre_m))
            self._renderer.update_maps("face", maps.position_map, maps.expression_map)
            self._renderer.draw([Placement(slot="face", world_from_head=matrix)], camera)
            images.append(self._renderer.read_image())
            covered.append(self._renderer.read_surface()[2] >= 0)
        return Drawing(np.stack(images), np.stack(covered))

    def close(self) -> None:
        """Give the GL context back."""
        self._context.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def evaluation_cameras(views: Sequence[str], size_px: int) -> tuple[Camera, ...]:
    """The stage's cameras of some evaluation views.

    Raises:
        ShapeError: A view that the stage does not have.
    """
    if unknown := sorted(set(views) - set(EVALUATION_VIEWS)):
        raise ShapeError(f"view {unknown[0]!r} is unknown; known are {list(EVALUATION_VIEWS)}")
    by_name = {camera.name: camera for camera in dome_cameras(5, size_px, size_px)}
    return tuple(by_name[name] for name in views)


def rendered_mse(a: Drawing, b: Drawing) -> float:
    """Mean squared error, 0-255, over the pixels that either drawing covers, all views together."""
    return masked_mse(a.images, b.images, a.covered | b.covered)


def masked_mse(a: Image, b: Image | FloatArray, where: npt.NDArray[np.bool_]) -> float:
    """Mean squared error, 0-255, over some pixels; 0 if there are none."""
    if not where.any():
        return 0.0
    return float(np.square(a[where].astype(np.float32) - b[where]).mean())


def psnr_db(mse: float) -> float:
    """Peak signal-to-noise ratio of an MSE on 0-255 values; infinite for no error."""
    return 20 * math.log10(PEAK) - 10 * math.log10(mse) if mse > 0 else math.inf
