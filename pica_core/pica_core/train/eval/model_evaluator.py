"""A trained model beside its capture: its pictures of frames, and what the cameras saw."""

import numpy as np
import torch
from torch import Tensor

from pica_core.model.interface import AvatarModel
from pica_core.train.data.training import TrainingData
from pica_core.train.painter import ModelPainter, Picture
from pica_core.train.rasterise import Rasteriser
from pica_core.types import FloatArray


class ModelEvaluator(ModelPainter):
    """Draws a model's pictures of a capture's frames.

    Args:
        rasteriser: Made for the topology that the model draws; it stays its owner's.
        samples: Samples along each side of a pixel, odd; the paper draws with one.
    """

    def __init__(
        self, data: TrainingData, model: AvatarModel, rasteriser: Rasteriser, *, samples: int = 1
    ) -> None:
        topology = data.meshes.topology(model.topology)
        super().__init__(model, topology, rasteriser, samples=samples)
        self.data = data

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

    def seen(self, picture: Picture, frame: int, view: str) -> FloatArray:
        """What the camera saw at a picture's pixels, 0-255, float32 ``[P, 3]``."""
        image = self.data.images.image(frame, view)
        return image.reshape(-1, 3)[picture.pixels].astype(np.float32)
