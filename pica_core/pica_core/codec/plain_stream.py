"""Latents and head pose <-> payload bytes, in the plain format: 8 bits a value, every frame on its
own.

Big-endian, 269 bytes (docs/bitstream.md, "The plain format"):

    offset  bytes  field
    0       1      format, 1
    1       6      head rotation, 3 x int16, rotation vector, unit pi / 32767 radians
    7       6      head translation, 3 x int16, unit 1 / 32767 metre
    13      256    latent, 8 x 8 x 4 x int8, row, column, channel; unit latent_scale[channel] / 127

The most negative code of each type is not used, so every sample has exactly one payload. What lies
beyond the range is clamped when it is encoded: a head that moves further than a metre from its seat
stops there.
"""

import struct

import numpy as np
import numpy.typing as npt

from pica_core.codec.latent_sample import EncodedFrame, LatentSample
from pica_core.errors import LatentError, ShapeError
from pica_core.latent import LATENT_SHAPE, NUM_LATENT
from pica_core.types import Float64Array

FORMAT_PLAIN = 1
ROTATION_RANGE = float(np.pi)
"""Largest component of a rotation vector, radians; longer vectors turn more than half a circle."""
TRANSLATION_RANGE_M = 1.0
"""Largest head offset from its seat per axis (chosen: an arm's length about the chair)."""

_POSE = struct.Struct(">B6h")
_POSE_LEVELS = 32_767
_LATENT_LEVELS = 127
PLAIN_BYTES = _POSE.size + NUM_LATENT


def encode_latent(
    latent: npt.ArrayLike,
    rotation: npt.ArrayLike,
    translation_m: npt.ArrayLike,
    latent_scale: tuple[float, ...],
) -> bytes:
    """Quantise a latent and a head pose.

    Args:
        latent: Expression code ``[8, 8, 4]``.
        rotation: Rotation vector, radians ``[3]``.
        translation_m: Offset from the seat, metres ``[3]``.
        latent_scale: Largest absolute value per channel, as the avatar's manifest says.

    Returns:
        269 bytes. Within range the error is at most half a unit of the table above.

    Raises:
        ShapeError: An argument of another shape.
        LatentError: A value that is not finite.
    """
    values = _checked("latent", latent, LATENT_SHAPE)
    turn = _checked("rotation", rotation, (3,))
    offset = _checked("translation_m", translation_m, (3,))
    ratios = np.concatenate([turn / ROTATION_RANGE, offset / TRANSLATION_RANGE_M])
    pose = np.rint(_POSE_LEVELS * np.clip(ratios, -1, 1))
    codes = np.rint(_LATENT_LEVELS * np.clip(values / np.asarray(latent_scale), -1, 1))
    return _POSE.pack(FORMAT_PLAIN, *map(int, pose)) + codes.astype(np.int8).tobytes()


def decode_latent(payload: bytes, latent_scale: tuple[float, ...]) -> LatentSample:
    """Read a payload.

    Raises:
        LatentError: Not a payload of this format: names the field and what was wanted.
    """
    if len(payload) < 1:
        raise LatentError("payload is empty")
    if payload[0] != FORMAT_PLAIN:
        raise LatentError(f"payload format is {payload[0]}; known is {FORMAT_PLAIN}")
    if len(payload) != PLAIN_BYTES:
        raise LatentError(f"payload has {len(payload)} bytes; {PLAIN_BYTES} are needed")
    pose = np.array(_POSE.unpack_from(payload)[1:], np.float32)
    codes = np.frombuffer(payload, np.int8, NUM_LATENT, _POSE.size).reshape(LATENT_SHAPE)
    if pose.min() < -_POSE_LEVELS or codes.min() < -_LATENT_LEVELS:
        raise LatentError("payload uses a code that no encoder writes (-128 or -32768)")
    pose /= _POSE_LEVELS
    step = np.asarray(latent_scale, np.float32) / np.float32(_LATENT_LEVELS)
    return LatentSample(
        latent=codes.astype(np.float32) * step,
        rotation=pose[:3] * np.float32(ROTATION_RANGE),
        translation_m=pose[3:] * np.float32(TRANSLATION_RANGE_M),
    )


def _checked(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> Float64Array:
    array = np.asarray(value, np.float64)
    if array.shape != shape:
        raise ShapeError(f"{name} is {array.shape}; {shape} is needed")
    if not np.isfinite(array).all():
        raise LatentError(f"{name} holds a value that is not finite")
    return array


class PlainEncoder:
    """The plain format as a stream: every frame is for everybody."""

    def __init__(self, latent_scale: tuple[float, ...]) -> None:
        self._latent_scale = latent_scale

    def encode(
        self,
        latent: npt.ArrayLike,
        rotation: npt.ArrayLike,
        translation_m: npt.ArrayLike,
        now_us: int,
    ) -> EncodedFrame | None:
        """Code a face, as `LatentEncoder.encode` does; the result is never None."""
        return EncodedFrame(encode_latent(latent, rotation, translation_m, self._latent_scale))

    def restart(self) -> None:
        """Nothing to do."""


class PlainDecoder:
    """The other end of `PlainEncoder`; keeps nothing between frames."""

    def __init__(self, latent_scale: tuple[float, ...]) -> None:
        self._latent_scale = latent_scale

    def decode(self, payload: bytes) -> LatentSample:
        """Decode a frame, as `LatentDecoder.decode` does."""
        return decode_latent(payload, self._latent_scale)
