"""Self-shadowing of a rig: how much of the dome, and of the key light, reaches each vertex.

As `occlusion` does it for the built-in heads: measured once by depth maps from many directions, at
rest and at a few strong expressions; a pose takes a mix of them. Shadow of combinations that no
single expression has is not known.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from pica_core.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.capture.rig_head import RigHead

FloatArray = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
DrawDepth = Callable[[FloatArray, FloatArray, int], FloatArray]

KEY_DIRECTION = np.array([0.50, 0.55, 0.80]) / np.linalg.norm([0.50, 0.55, 0.80])
"""Must agree with shaders/rig_stage.frag."""
DOME_DIRECTIONS = 28
KEY_DIRECTIONS = 6
KEY_SPREAD = 0.22
"""Half angle of the key light, radians: a softbox, so shadows have soft edges."""
MAP_SIZE = 192
SPAN_M = 0.42
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
"""Expressions whose shadow is measured; each is set to 1 as a whole. Those that the rig does not
have cost nothing."""


def _orthographic(direction: Float64Array) -> FloatArray:
    """Clip matrix that looks against `direction` at the head's middle."""
    up = np.array([0.0, 0.0, 1.0]) if abs(direction[1]) > 0.9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    rows = np.stack([right, np.cross(direction, right), -direction]) / (0.5 * SPAN_M)
    clip = np.eye(4, dtype=np.float32)
    clip[:3, :3] = rows
    clip[:3, 3] = -rows @ np.array([0.0, -0.03, 0.0])
    return clip


def _sphere() -> Float64Array:
    """Even directions over the sphere. ``[n, 3]``."""
    k = np.arange(DOME_DIRECTIONS) + 0.5
    y = 1 - 2 * k / DOME_DIRECTIONS
    turn, ring = np.pi * (1 + 5**0.5) * k, np.sqrt(1 - y * y)
    return np.stack([ring * np.cos(turn), y, ring * np.sin(turn)], 1)


def _softbox() -> Float64Array:
    """Even directions over the key light's disc. ``[n, 3]``."""
    a = np.cross(KEY_DIRECTION, [0.0, 1.0, 0.0])
    a /= np.linalg.norm(a)
    b = np.cross(KEY_DIRECTION, a)
    k = np.arange(KEY_DIRECTIONS) + 0.5
    reach, spin = KEY_SPREAD * np.sqrt(k / KEY_DIRECTIONS), np.pi * (1 + 5**0.5) * k
    disc = KEY_DIRECTION + reach[:, None] * (np.cos(spin)[:, None] * a + np.sin(spin)[:, None] * b)
    result: Float64Array = disc / np.linalg.norm(disc, axis=1, keepdims=True)
    return result


class RigOcclusion:
    """Shadow of one rig as a function of its expression.

    Args:
        head: The rig.
        draw_depth: Draws a depth map of vertices along a clip matrix (`rig_gpu.RigRenderer`).
    """

    def __init__(self, head: RigHead, draw_depth: DrawDepth) -> None:
        self._head = head
        self._draw_depth = draw_depth
        zero = np.zeros(NUM_ARKIT, np.float32)
        self._rest = self._measure(zero)
        self._poses = [p for p in POSES if set(p) <= set(head.names.drivers)]
        changes = []
        for names in self._poses:
            arkit = zero.copy()
            arkit[[ARKIT_INDEX[name] for name in names]] = 1.0
            changes.append(self._measure(arkit) - self._rest)
        self._changes = np.array(changes, np.float32).reshape(len(self._poses), -1)

    def _measure(self, arkit: FloatArray) -> FloatArray:
        vertices = self._head.vertices(arkit)
        normals = self._head.normals(vertices)
        lifted = vertices + LIFT_M * normals
        sky = np.zeros(len(vertices))
        weight = np.full(len(vertices), 1e-6)
        for direction in _sphere():
            # Light from above counts more: a dome, not a fog.
            facing = np.maximum(normals @ direction, 0.0) * (0.65 + 0.35 * direction[1])
            sky += facing * self._lit(vertices, lifted, direction)
            weight += facing
        key = np.mean([self._lit(vertices, lifted, direction) for direction in _softbox()], axis=0)
        return np.stack([sky / weight, key], 1).astype(np.float32)

    def _lit(
        self, vertices: FloatArray, lifted: FloatArray, direction: Float64Array
    ) -> npt.NDArray[np.bool_]:
        clip = _orthographic(direction)
        depth = self._draw_depth(vertices, clip, MAP_SIZE)
        seen = lifted @ clip[:3, :3].T + clip[:3, 3]
        at = np.clip(((seen[:, :2] * 0.5 + 0.5) * MAP_SIZE).astype(int), 0, MAP_SIZE - 1)
        nearest = depth[at[:, 1], at[:, 0]]
        lit: npt.NDArray[np.bool_] = 0.5 + 0.5 * seen[:, 2] <= nearest + BIAS_M / SPAN_M
        return lit

    def at(self, arkit: FloatArray) -> FloatArray:
        """Share of dome and key light that reaches each vertex. float32 ``[V, 2]``."""
        mixed = self._rest
        if self._poses:
            weights = [np.mean([arkit[ARKIT_INDEX[name]] for name in p]) for p in self._poses]
            share = np.clip(np.array(weights, np.float32), 0, 1)
            mixed = mixed + (share @ self._changes).reshape(mixed.shape)
        result: FloatArray = np.clip(mixed, 0.0, 1.0)
        return result
