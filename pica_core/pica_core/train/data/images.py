"""The images of a capture behind a cache of bounded size, and the cameras that took them."""

from functools import cache, lru_cache

import numpy as np
import torch
from torch import Tensor

from pica_core.camera import Camera
from pica_core.capture.dataset import multiface
from pica_core.capture.dataset.dataset import Capture, CaptureReader, Request
from pica_core.model.encoder import resize_texture
from pica_core.types import FloatArray, Image

IMAGE_CACHE_BYTES = 4 << 30
"""Decoded images, depth and textures kept in memory; the least recently used go first."""
MAX_TEXTURES = 2048
"""The same of textures as tensors: 0.8 MB each at 256 x 256."""


class ImageCache:
    """Images, depth, textures and backgrounds by frame and camera.

    Attributes:
        evaluation_views: Cameras that errors are measured from; all where the capture names none.
    """

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self.reader = CaptureReader(capture, IMAGE_CACHE_BYTES)
        self.camera_names = [camera.name for camera in capture.cameras]
        named = capture.info.get("evaluation_views", [])
        views = [name for name in self.camera_names if name in named]
        self.evaluation_views = views or self.camera_names
        self._texture = lru_cache(MAX_TEXTURES)(self._texture_of)
        self._cameras_of = cache(lambda frame: capture.cameras_of(capture.frames[frame]))
        self._head_pose = cache(lambda frame: capture.head_to_world(capture.frames[frame]))

    def image(self, frame: int, camera: str) -> Image:
        """An image; uint8 ``[H, W, 3]``.

        Raises:
            CaptureError: It cannot be read.
        """
        return self.reader.read(Request("image", frame, camera))

    def depth_m(self, frame: int, camera: str) -> FloatArray:
        """Measured depth, 0 where unknown, float32 ``[H, W]``."""
        if not self._has_depth(frame, camera):
            unknown = self._capture.camera(camera)
            return np.zeros((unknown.height, unknown.width), np.float32)
        depth_m: FloatArray = self.reader.read(Request("depth", frame, camera))
        return depth_m

    def textures(self, frames: list[int], size: int) -> Tensor:
        """Average textures of frames, about [-1, 1], ``[N, 3, size, size]``."""
        return torch.stack([self._texture(frame, size) for frame in frames])

    def cameras_of(self, frame: int) -> tuple[str, ...]:
        """Cameras that have an image of a frame, whether or not it can be read."""
        return self._cameras_of(frame)

    def evaluation_views_of(self, frame: int) -> list[str]:
        """Evaluation views that have an image of a frame."""
        return [name for name in self.evaluation_views if name in self.cameras_of(frame)]

    def expect(self, images: list[tuple[int, str]], *, depth: bool) -> None:
        """Have images decoded while something else goes on."""
        self.reader.ask(Request("image", *image) for image in images)
        if depth:
            self.reader.ask(Request("depth", *image) for image in images if self._has_depth(*image))

    def camera(self, frame: int, name: str) -> Camera:
        """The camera of an image in the frame's head axes: head to camera."""
        return self._capture.camera(name).in_head(self._head_pose(frame))

    def _has_depth(self, frame: int, camera: str) -> bool:
        where = self._capture.frames[frame]
        path = multiface.image_path("depth", where.segment, camera, where.name)
        return self._capture.has_depth and (self._capture.path / path).is_file()

    def _texture_of(self, frame: int, size: int) -> Tensor:
        stored = torch.from_numpy(self.reader.read(Request("texture", frame)).copy())
        texture = stored.permute(2, 0, 1)[None].to(torch.float32) / 127.5 - 1
        return resize_texture(texture, size)[0]


def view_direction(camera: Camera) -> FloatArray:
    """Unit vector from the head's origin to a camera in head axes, ``[3]``."""
    centre = camera.centre_m
    return (centre / np.linalg.norm(centre)).astype(np.float32)
