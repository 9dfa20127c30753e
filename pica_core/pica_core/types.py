"""Array types, named once: what an annotation says of an array's elements; and a latent's shape.

Shapes stand in docstrings, because annotations cannot say them: arrays on the wire and in numpy are
channel-last, torch is ``[N, C, H, W]``.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
"""Any array, where the elements' type does not matter or is checked at run time."""
FloatArray = npt.NDArray[np.float32]
"""Elements are float32: what travels, is decoded and is drawn."""
Float64Array = npt.NDArray[np.float64]
"""Elements are float64: what is measured, and what references compute."""
IntArray = npt.NDArray[np.int32]
"""Elements are int32: triangles, levels and quantised values."""
Int64Array = npt.NDArray[np.int64]
"""Elements are int64: numpy's own indices."""
BoolArray = npt.NDArray[np.bool_]
"""Elements are booleans: masks."""
ByteArray = npt.NDArray[np.uint8]
"""Elements are uint8: bytes and 8 bit colours."""
Image = ByteArray
"""A picture in sRGB, row 0 on top. uint8 ``[H, W, 3]``."""


LATENT_SIZE = 8
LATENT_CHANNELS = 4
LATENT_SHAPE = (LATENT_SIZE, LATENT_SIZE, LATENT_CHANNELS)
"""Rows, columns, channels of Z. Channel-last, as on the wire."""
NUM_LATENT = LATENT_SIZE * LATENT_SIZE * LATENT_CHANNELS
MAX_LATENT_LENGTH = 128.0
"""Receivers shorten longer latents to this (measured: faces take 35, crowds of random shapes 60):
what an avatar's file may do to the face of an extreme latent is bounded."""
