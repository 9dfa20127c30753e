"""Which vertices light reaches: what measuring a head's shadow on itself is made of."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from pica_core.types import Float64Array, FloatArray

DrawDepth = Callable[[FloatArray, FloatArray, int], FloatArray]
"""Draws a depth map of vertices along a clip matrix, so many texels wide."""

KEY_DIRECTION = np.array([0.50, 0.55, 0.80]) / np.linalg.norm([0.50, 0.55, 0.80])
"""Must agree with shaders/stage.frag and shaders/rig_stage.frag."""
KEY_SPREAD = 0.22
"""Half angle of the key light, radians: a softbox, so shadows have soft edges."""
MAP_SIZE = 192
BIAS_M, LIFT_M = 0.0022, 0.0015
POSES: tuple[tuple[str, ...], ...] = (
    ("jawOpen",),
    ("mouthFunnel",),
    ("mouthPucker",),
    ("mouthSmileLeft", "mouthSmileRight"),
    ("eyeBlinkLeft",),
    ("eyeBlinkRight",),
    ("browDownLeft", "browDownRight"),
    ("mouthUpperUpLeft", "mouthUpperUpRight", "mouthLowerDownLeft", "mouthLowerDownRight"),
)
"""Expressions whose shadow is measured; each is set to 1 as a whole."""


def sphere(count: int) -> Float64Array:
    """Even directions over the sphere. ``[n, 3]``."""
    k = np.arange(count) + 0.5
    y = 1 - 2 * k / count
    turn, ring = np.pi * (1 + 5**0.5) * k, np.sqrt(1 - y * y)
    return np.stack([ring * np.cos(turn), y, ring * np.sin(turn)], 1)


def softbox(count: int) -> Float64Array:
    """Even directions over the key light's disc. ``[n, 3]``."""
    a = np.cross(KEY_DIRECTION, [0.0, 1.0, 0.0])
    a /= np.linalg.norm(a)
    b = np.cross(KEY_DIRECTION, a)
    k = np.arange(count) + 0.5
    reach, spin = KEY_SPREAD * np.sqrt(k / count), np.pi * (1 + 5**0.5) * k
    disc = KEY_DIRECTION + reach[:, None] * (np.cos(spin)[:, None] * a + np.sin(spin)[:, None] * b)
    result: Float64Array = disc / np.linalg.norm(disc, axis=1, keepdims=True)
    return result


def lit(
    draw_depth: DrawDepth,
    vertices: FloatArray,
    normals: FloatArray,
    direction: Float64Array,
    *,
    span_m: float,
    centre_m: tuple[float, float, float],
) -> npt.NDArray[np.bool_]:
    """Which vertices see light from a direction.

    Args:
        draw_depth: See `DrawDepth`.
        vertices: Metres, ``[V, 3]``.
        normals: ``[V, 3]``.
        direction: Towards the light, unit length.
        span_m: Width of the depth map.
        centre_m: What it is aimed at.

    Returns:
        bool ``[V]``.
    """
    up = np.array([0.0, 0.0, 1.0]) if abs(direction[1]) > 0.9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    rows = np.stack([right, np.cross(direction, right), -direction]) / (0.5 * span_m)
    clip = np.eye(4, dtype=np.float32)
    clip[:3, :3] = rows
    clip[:3, 3] = -rows @ np.array(centre_m)
    depth = draw_depth(vertices, clip, MAP_SIZE)
    lifted = vertices + LIFT_M * normals
    seen = lifted @ clip[:3, :3].T + clip[:3, 3]
    at = np.clip(((seen[:, :2] * 0.5 + 0.5) * MAP_SIZE).astype(int), 0, MAP_SIZE - 1)
    nearest = depth[at[:, 1], at[:, 0]]
    reached: npt.NDArray[np.bool_] = 0.5 + 0.5 * seen[:, 2] <= nearest + BIAS_M / span_m
    return reached
