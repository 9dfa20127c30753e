"""How eyeballs turn: what the ARKit look shapes mean in angles, for every kind of head."""

import numpy as np

from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.types import Array, FloatArray

EYE_YAW, EYE_PITCH_UP, EYE_PITCH_DOWN = np.radians([35.0, 25.0, 28.0])
"""Gaze at a look shape of 1, radians."""


def gaze(side: float, values: Array) -> tuple[Array, Array]:
    """Yaw and pitch of one eye at ARKit values ``[..., 52]``, radians ``[...]``; `side` is 1 for
    the left eye, -1 for the right."""
    name = "Left" if side > 0 else "Right"
    out, inwards, up, down = (
        values[..., ARKIT_INDEX[f"eyeLook{way}{name}"]] for way in ("Out", "In", "Up", "Down")
    )
    return side * EYE_YAW * (out - inwards), EYE_PITCH_UP * up - EYE_PITCH_DOWN * down


def turn(offsets: FloatArray, yaw: Array | float, pitch: Array | float) -> Array:
    """Offsets from an eyeball's centre, turned up by the pitch and then sideways. ``[..., 3]``."""
    sp, cp, sy, cy = np.sin(pitch), np.cos(pitch), np.sin(yaw), np.cos(yaw)
    x, y, z = offsets.T
    y, z = cp * y + sp * z, cp * z - sp * y
    return np.stack([cy * x + sy * z, y, cy * z - sy * x], -1)
