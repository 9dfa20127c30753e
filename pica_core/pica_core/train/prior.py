"""What a capture tells a model before training: mean shape, its unit, meshes and mean texture."""

import numpy as np
import numpy.typing as npt

from pica_core.model.interface import FacePrior
from pica_core.train.data.sampler import spaced
from pica_core.train.data.training import TrainingData
from pica_core.types import FloatArray

TEXTURE_FRAMES = 32
"""Training frames whose average textures make the mean one: evenly spaced, enough for a start."""


def face_prior(data: TrainingData) -> FacePrior:
    """The prior of a capture, from its training frames alone."""
    capture = data.capture
    some = [capture.frames[index] for index in spaced(data.train_frames, TEXTURE_FRAMES)]
    texture = np.zeros((capture.texture_size, capture.texture_size, 3))
    for frame in some:
        texture += capture.average_texture(frame)
    return FacePrior(
        position_mean=data.meshes.position_mean,
        tracked_position_mean=data.meshes.tracked_position_mean(),
        position_scale_m=data.meshes.position_scale_m,
        dense_uv=_float32(capture.topology.vertex_uv),
        tracked_uv=_float32(capture.tracked_topology.vertex_uv),
        tracked_mean_m=_float32(data.meshes.tracked_mean_m),
        texture_mean=_float32(texture / (255 * len(some))),
    )


def _float32(array: npt.ArrayLike) -> FloatArray:
    return np.ascontiguousarray(array, np.float32)
