"""52 ARKit shapes -> the avatar's latent: the part of an avatar that a sender runs, in plain numpy.

A small fully connected network trained against the model's own codes; about 0.1 M multiply-adds, so
numpy is fast enough and a sender needs no inference library.
"""

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import ENCODER_CHANNELS, LEAKY_SLOPE
from pica_core.errors import ShapeError
from pica_core.types import LATENT_SHAPE, FloatArray


class ExpressionEncoder:
    """The expression encoder of one avatar. Keeps no state between calls."""

    def __init__(self, avatar: Avatar) -> None:
        # Transposed once, in memory order: a row vector times a matrix reads it in one sweep.
        self._layers: list[tuple[FloatArray, FloatArray]] = [
            (
                np.ascontiguousarray(avatar.tensors[f"encoder.{index}.weight"].T),
                avatar.tensors[f"encoder.{index}.bias"],
            )
            for index in range(len(ENCODER_CHANNELS))
        ]

    def encode(self, arkit: npt.ArrayLike) -> FloatArray:
        """Encode one expression or many.

        Args:
            arkit: Values in `ARKIT_NAMES` order. float32 ``[52]`` or ``[N, 52]``. Values outside
                [0, 1] are taken as they are; trackers overshoot a little.

        Returns:
            Latents, float32 ``[8, 8, 4]`` or ``[N, 8, 8, 4]``.

        Raises:
            ShapeError: The last dimension is not 52, or there are more than two.
        """
        values: FloatArray = np.asarray(arkit, np.float32)
        if values.ndim not in (1, 2) or values.shape[-1] != NUM_ARKIT:
            raise ShapeError(
                f"arkit is {values.shape}; [{NUM_ARKIT}] or [N, {NUM_ARKIT}] is needed"
            )
        batch = values.shape[:-1]
        for index, (weight, bias) in enumerate(self._layers):
            if index > 0:
                values = np.maximum(values, np.float32(LEAKY_SLOPE) * values)
            values = np.matmul(values, weight) + bias
        return values.reshape(*batch, *LATENT_SHAPE)
