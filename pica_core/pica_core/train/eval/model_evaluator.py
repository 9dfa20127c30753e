"""A trained model beside its capture: its pictures of frames, and what the cameras saw."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pica_core.camera import Camera
from pica_core.model.interface import AvatarModel, Surface
from pica_core.train.data.images import view_direction
from pica_core.train.data.training import TrainingData
from pica_core.train.drawing import MeshDrawer
from pica_core.train.rasterise import Rasteriser
from pica_core.types import BoolArray, ByteArray, FloatArray, Int64Array


class Picture(NamedTuple):
    """The P pixels of an image that a mesh covers, in reading order.

    Attributes:
        pixels: Flat indices, row * W + column, int64 ``[P]``.
        colours: 0-255, clamped, float32 ``[P, 3]``.
        depth_m: Along the camera's axis, float32 ``[P]``.
    """

    pixels: Int64Array
    colours: FloatArray
    depth_m: FloatArray

    def on(self, image: npt.NDArray[np.generic]) -> FloatArray:
        """The picture laid over an image, ``[H, W, 3]``."""
        laid: FloatArray = image.astype(np.float32)
        laid.reshape(-1, 3)[self.pixels] = self.colours
        return laid

    def within(self, image: ByteArray) -> FloatArray:
        """What an image ``[H, W, 3]`` holds at these pixels, 0-255, float32 ``[P, 3]``."""
        return image.reshape(-1, 3)[self.pixels].astype(np.float32)

    def covered(self, camera: Camera) -> BoolArray:
        """Which pixels of the image these are, ``[H, W]``."""
        mask = np.zeros(camera.height * camera.width, np.bool_)
        mask[self.pixels] = True
        return mask.reshape(camera.height, camera.width)


class ModelEvaluator:
    """Draws a model's pictures of latents and of a capture's frames; the rasteriser, made for the
    topology that the model draws, stays its owner's."""

    def __init__(self, data: TrainingData, model: AvatarModel, rasteriser: Rasteriser) -> None:
        topology = data.meshes.topology(model.topology)
        self.data = data
        self.model = model
        self._drawer = MeshDrawer(rasteriser, topology)
        self._device = next(model.parameters()).device

    @torch.no_grad()
    def encode(self, frame: int) -> Tensor:
        """The encoder's mean for a frame, ``[1, 4, 8, 8]``."""
        texture = self.data.images.textures([frame], self.model.encoder.texture_size)
        maps = self.data.meshes.position_maps([frame])
        mean: Tensor = self.model.encoder(texture.to(self._device), maps.to(self._device))[0]
        return mean

    @torch.no_grad()
    def drive(self, frame: int) -> Tensor:
        """What a live sender would send for a frame, ``[1, 4, 8, 8]``."""
        arkit = self.data.arkit[[frame]].to(self._device)
        latent: Tensor = self.model.expression_encoder(arkit)
        return latent

    @torch.no_grad()
    def vertices_m(self, latent: Tensor) -> FloatArray:
        """Decoded vertices of one latent, on the topology that the model draws, ``[V, 3]``."""
        vertices: FloatArray = self.model.vertices(latent)[0].cpu().numpy()
        return vertices

    @torch.no_grad()
    def draw(
        self,
        latent: Tensor,
        camera: Camera,
        *,
        vertices_m: FloatArray | None = None,
    ) -> Picture:
        """The picture of one latent through a camera in head axes.

        Args:
            latent: ``[1, 4, 8, 8]``.
            camera: In head axes.
            vertices_m: What `vertices_m` gives of this latent, if it is known already.
        """
        found_m = torch.from_numpy(self.vertices_m(latent) if vertices_m is None else vertices_m)
        direction = torch.from_numpy(view_direction(camera))[None].to(self._device)
        appearance = self.model.appearance(latent, direction)
        drawn = self._drawer.draw(found_m[None], [camera])
        pixels = drawn.pixels.pixel
        if not len(pixels):
            return Picture(pixels, np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
        surface = Surface(*(values.to(self._device) for values in drawn.surface))
        colours = self.model.shade(appearance, surface)
        shown = 255 * colours.clamp(0, 1).cpu().numpy()
        return Picture(pixels, shown.astype(np.float32), drawn.depth_m.numpy())
