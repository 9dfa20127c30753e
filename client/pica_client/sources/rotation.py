"""Trackers' head angles as rotation vectors."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def rotation_vector_from_yaw_pitch_roll(
    yaw_pitch_roll: npt.NDArray[np.float64],
) -> npt.NDArray[np.float32]:
    """Compose yaw about +y, then pitch about +x, then roll about +z, each in the turned frame.

    Args:
        yaw_pitch_roll: Radians. float64 ``[T, 3]``.

    Returns:
        Rotation vectors (axis times angle, angle at most π). float32 ``[T, 3]``.
    """
    half = yaw_pitch_roll / 2
    (cos_y, cos_p, cos_r), (sin_y, sin_p, sin_r) = np.cos(half).T, np.sin(half).T
    # Quaternion product y(yaw) * x(pitch) * z(roll), written out.
    real = cos_y * cos_p * cos_r + sin_y * sin_p * sin_r
    imaginary = np.stack(
        (
            cos_y * sin_p * cos_r + sin_y * cos_p * sin_r,
            sin_y * cos_p * cos_r - cos_y * sin_p * sin_r,
            cos_y * cos_p * sin_r - sin_y * sin_p * cos_r,
        ),
        axis=1,
    )
    flip = np.where(real < 0, -1.0, 1.0)  # q and -q are one rotation; take the shorter way round
    real, imaginary = real * flip, imaginary * flip[:, None]
    sine = np.linalg.norm(imaginary, axis=1)
    # angle / sin(angle / 2) tends to 2 where the head does not turn at all.
    scale = np.where(sine > 1e-12, 2 * np.arctan2(sine, real) / np.maximum(sine, 1e-12), 2.0)
    return (imaginary * scale[:, None]).astype(np.float32)
