"""What several benches draw: one head before a camera, at rest, talking, or from the views of the
stage."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import moderngl
import numpy as np
import numpy.typing as npt

from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.request import DecodedMaps
from pica_client.render.drawing import Drawing, HeadRenderer
from pica_client.render.scene import head_matrix, view_direction
from pica_client.system import Closing
from pica_core.avatar.file import Avatar
from pica_core.avatar.manifest import Manifest
from pica_core.camera import Camera, dome_cameras, look_at
from pica_core.gl import create_context
from pica_core.types import FloatArray

FIELD_OF_VIEW = math.radians(50)
"""Opening of the camera both ways, radians: the distances 18, 65 and 120 cm then cover pixels in
about the ratios of the paper's Table 3 (2.7 : 0.9 : 0.2 million)."""
_NO_POSE = np.zeros(3, np.float32)


def front_camera(head: Manifest, distance_cm: float, size: tuple[int, int]) -> Camera:
    """A camera before the middle of a head.

    Args:
        distance_cm: From the front of its bounding box.
        size: Columns and rows of the image, pixels.
    """
    low, high = head.bounds_min_m, head.bounds_max_m
    height, distance_m = (low[1] + high[1]) / 2, high[2] + distance_cm / 100
    return look_at(
        centre_m=(0.0, height, distance_m),
        target_m=(0.0, height, 0.0),
        vertical_fov=FIELD_OF_VIEW,
        width=size[0],
        height=size[1],
    )


@contextmanager
def gl_context() -> Iterator[moderngl.Context]:
    """A GL context for a block.

    Raises:
        GraphicsError: There is none; names the fix.
    """
    context = create_context()
    try:
        yield context
    finally:
        context.release()


class FaceRenderer(Closing):
    """Draws the latents of one avatar from views of the stage, through the real decoder and
    renderer; belongs to one thread.

    Args:
        size_px: Rows and columns of each image.
        views: Names among the stage's evaluation views.

    Raises:
        GraphicsError: No GL context; names the fix.
    """

    def __init__(self, avatar: Avatar, *, size_px: int, views: Sequence[str]) -> None:
        self._cameras = evaluation_cameras(views, size_px)
        self._decoder = OnnxDecoder(avatar)
        self._context = create_context()
        self._renderer = HeadRenderer(self._context, avatar, size_px)

    def draw(
        self,
        latent: FloatArray,
        rotation: npt.ArrayLike = _NO_POSE,
        translation_m: npt.ArrayLike = _NO_POSE,
        level: int | None = None,
    ) -> list[tuple[Drawing, DecodedMaps]]:
        """Draw a face from every view; what was drawn, and what it was drawn of.

        Args:
            latent: float32 ``[8, 8, 4]``.
            rotation: Head pose, rotation vector in radians ``[3]``.
            translation_m: Head offset, metres ``[3]``.
            level: Of detail; None is the full one.
        """
        matrix = head_matrix(np.eye(4), rotation, translation_m)
        drawn = []
        for camera in self._cameras:
            maps = self._decoder.decode(latent, view_direction(matrix, camera.centre_m), level)
            drawn.append((self._renderer.draw(maps, camera, matrix), maps))
        return drawn

    def close(self) -> None:
        """Give the GL context back."""
        self._context.release()


def evaluation_cameras(views: Sequence[str], size_px: int) -> tuple[Camera, ...]:
    """The stage's cameras of some evaluation views."""
    by_name = {camera.name: camera for camera in dome_cameras(5, size_px, size_px)}
    return tuple(by_name[name] for name in views)
