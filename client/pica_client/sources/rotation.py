"""Rotation vectors from trackers' head angles and quaternions, and back to angles."""

import math
from collections.abc import Sequence

import numpy as np

from pica_core.types import Float64Array, FloatArray


def rotation_vector_from_yaw_pitch_roll(yaw_pitch_roll: Float64Array) -> FloatArray:
    """Compose yaw about +y, then pitch about +x, then roll about +z, each in the turned frame.

    Args:
        yaw_pitch_roll: Radians. float64 ``[T, 3]``.

    Returns:
        Rotation vectors (axis times angle, angle at most π). float32 ``[T, 3]``.
    """
    turns = []
    for yaw, pitch, roll in (yaw_pitch_roll / 2).tolist():
        tilted = _product(
            (math.cos(yaw), 0.0, math.sin(yaw), 0.0), (math.cos(pitch), math.sin(pitch), 0.0, 0.0)
        )
        rolled = _product(tilted, (math.cos(roll), 0.0, 0.0, math.sin(roll)))
        turns.append(rotation_vector_from_quaternion(rolled))
    return np.array(turns, np.float32).reshape(-1, 3)


def yaw_pitch_roll_from_rotation_vector(rotation: FloatArray) -> tuple[float, float, float]:
    """The angles, radians, that `rotation_vector_from_yaw_pitch_roll` composes to a rotation."""
    w, x, y, z = _quaternion(rotation)
    yaw = math.atan2(2 * (x * z + w * y), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(max(2 * (w * x - y * z), -1.0), 1.0))
    return yaw, pitch, math.atan2(2 * (x * y + w * z), 1 - 2 * (x * x + z * z))


def turned(rotation: FloatArray, turn: FloatArray) -> FloatArray:
    """A rotation, and after it another turn; all are rotation vectors, float32 ``[3]``."""
    return rotation_vector_from_quaternion(_product(_quaternion(turn), _quaternion(rotation)))


def _quaternion(vector: FloatArray) -> tuple[float, float, float, float]:
    """The unit quaternion (real part first) of a rotation vector."""
    x, y, z = vector.tolist()
    angle = math.hypot(x, y, z)
    scale = math.sin(angle / 2) / angle if angle > 1e-12 else 0.5
    return math.cos(angle / 2), scale * x, scale * y, scale * z


def rotation_vector_from_quaternion(quaternion: Sequence[float]) -> FloatArray:
    """The rotation vector of a quaternion, with an angle of at most π."""
    real, *imaginary = quaternion
    if real < 0:  # an angle above π is the rest of the turn, the other way round
        real, imaginary = -real, [-part for part in imaginary]
    sine = math.hypot(*imaginary)
    scale = 2 * math.atan2(sine, real) / sine if sine > 1e-12 else 2.0
    return np.array([scale * part for part in imaginary], np.float32)


def _product(left: Sequence[float], right: Sequence[float]) -> tuple[float, float, float, float]:
    """The turn `right`, and after it `left`."""
    a, b, c, d = left
    e, f, g, h = right
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )
