"""Latents and head pose <-> payload bytes, in the plain format: 8 bits a value, every frame on its
own.

Big-endian, 269 bytes:

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
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pica_core.codec.latent_sample import DecodedFrame, EncodedFrame, LatentSample, ReceivedFrame
from pica_core.errors import LatentError, ShapeError
from pica_core.latent import LATENT_CHANNELS, LATENT_SHAPE, NUM_LATENT

FORMAT_PLAIN = 1
ROTATION_RANGE = float(np.pi)
"""Largest component of a rotation vector, radians; longer vectors turn more than half a circle."""
TRANSLATION_RANGE_M = 1.0
"""Largest head offset from its seat per axis (chosen: an arm's length about the chair)."""

_POSE = struct.Struct(">B6h")
_POSE_LEVELS = 32_767
_LATENT_LEVELS = 127
PLAIN_BYTES = _POSE.size + NUM_LATENT


@dataclass(frozen=True, kw_only=True, slots=True)
class LatentProfile:
    """What both ends must know of an avatar to read its latents; comes with the avatar file."""

    latent_scale: tuple[float, float, float, float]
    """Largest absolute value per channel."""

    def __post_init__(self) -> None:
        if len(self.latent_scale) != LATENT_CHANNELS or not all(
            0 < scale < np.inf for scale in self.latent_scale
        ):
            raise ValueError(f"latent_scale is {self.latent_scale}; 4 positive numbers are needed")


def encode_latent(
    latent: npt.ArrayLike,
    rotation: npt.ArrayLike,
    translation_m: npt.ArrayLike,
    profile: LatentProfile,
) -> bytes:
    """Quantise a latent and a head pose.

    Args:
        latent: Expression code ``[8, 8, 4]``.
        rotation: Rotation vector, radians ``[3]``.
        translation_m: Offset from the seat, metres ``[3]``.

    Returns:
        269 bytes. Within range the error is at most half a unit of the table above.

    Raises:
        ShapeError: An argument of another shape.
        LatentError: A value that is not finite.
    """
    values = _checked("latent", latent, LATENT_SHAPE)
    turn = _checked("rotation", rotation, (3,))
    offset = _checked("translation_m", translation_m, (3,))
    codes = _quantise(values / np.asarray(profile.latent_scale), _LATENT_LEVELS).astype(np.int8)
    pose = _quantise(
        np.concatenate([turn / ROTATION_RANGE, offset / TRANSLATION_RANGE_M]), _POSE_LEVELS
    )
    return _POSE.pack(FORMAT_PLAIN, *map(int, pose)) + codes.tobytes()


def decode_latent(payload: bytes, profile: LatentProfile) -> LatentSample:
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
    step = np.asarray(profile.latent_scale, np.float32) / np.float32(_LATENT_LEVELS)
    return LatentSample(
        latent=codes.astype(np.float32) * step,
        rotation=pose[:3] * np.float32(ROTATION_RANGE),
        translation_m=pose[3:] * np.float32(TRANSLATION_RANGE_M),
    )


def _checked(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    array: npt.NDArray[np.float64] = np.asarray(value, np.float64)
    if array.shape != shape:
        raise ShapeError(f"{name} is {array.shape}; {shape} is needed")
    if not np.isfinite(array).all():
        raise LatentError(f"{name} holds a value that is not finite")
    return array


def _quantise(ratio: npt.NDArray[np.float64], levels: int) -> npt.NDArray[Any]:
    return np.clip(np.rint(ratio * levels), -levels, levels)


class PlainEncoder:
    """The plain format as a stream: every frame is a keyframe of layer 0."""

    def __init__(self, profile: LatentProfile) -> None:
        self._profile = profile

    def encode(
        self,
        latent: npt.ArrayLike,
        rotation: npt.ArrayLike,
        translation_m: npt.ArrayLike,
        now_us: int,
    ) -> EncodedFrame | None:
        """Code a face, as `LatentEncoder.encode` does; the result is never None."""
        return EncodedFrame(encode_latent(latent, rotation, translation_m, self._profile))

    def request_keyframe(self) -> None:
        """Nothing to do."""

    def restart(self) -> None:
        """Nothing to do."""


class PlainDecoder:
    """The other end of `PlainEncoder`; keeps nothing between frames."""

    needs_keyframe = False
    num_unreferenced = 0

    def __init__(self, profile: LatentProfile) -> None:
        self._profile = profile

    def receive(self, frame: ReceivedFrame) -> list[DecodedFrame]:
        """Decode a frame, as `LatentDecoder.receive` does."""
        return [frame.decoded(decode_latent(frame.payload, self._profile))]
