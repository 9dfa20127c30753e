"""Shadow of a head on itself: how much of the dome, and of the key light, reaches each vertex.

Measured once per head by depth maps from many directions, at rest and at a few strong expressions;
a pose takes a mix of them. So soft shadow of nose, brows, hair and lips moves with the face at no
cost per frame. What it does not know: shadow of combinations that no single expression has.
"""

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.capture.rig.head import RigHead
from pica_core.capture.triangles import edges
from pica_core.types import BoolArray, Float64Array, FloatArray

KEY_DIRECTION = np.array([0.50, 0.55, 0.80]) / np.linalg.norm([0.50, 0.55, 0.80])
"""Must agree with shaders/stage.frag."""
KEY_SPREAD = 0.22
"""Half angle of the key light, radians: a softbox, so shadows have soft edges."""
SOFTENED = 2
"""How often a vertex takes half of its neighbours' light: no shadow is a saw of triangles."""
DOME_DIRECTIONS, KEY_DIRECTIONS = 28, 6
"""Directions of the dome's light, and within the key light's disc."""
DEPTH_MAP_SIZE = 192
SPAN_M = 0.42
"""Width of the depth maps, at least."""
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


class Occlusion:
    """Shadow of one head as a function of its expression.

    Args:
        draw_depth: Draws a depth map of vertices along a clip matrix, so many texels wide.
        centre_y_m: Height that the depth maps are aimed at, head frame.
    """

    def __init__(
        self,
        head: RigHead,
        draw_depth: Callable[[FloatArray, FloatArray, int], FloatArray],
        centre_y_m: float,
    ) -> None:
        self._head, self._draw_depth = head, draw_depth
        self._span_m = max(SPAN_M, float(np.ptp(head.mesh.rest_m, axis=0).max()) + 0.05)
        self._centre_m = np.array([0.0, centre_y_m, 0.0])
        ends = edges(head.chart.faces).T
        self._neighbours = coo_array((np.ones(ends.shape[1]), tuple(ends))).tocsr()
        self._neighbours += self._neighbours.T
        self._poses = [p for p in POSES if all(name in head.names.drivers for name in p)]
        self._rest = self._measure(())
        changes = [self._measure(names) - self._rest for names in self._poses]
        self._changes = np.array(changes, np.float32).reshape(len(changes), self._rest.size)

    def _measure(self, shapes: tuple[str, ...]) -> FloatArray:
        arkit = np.zeros(NUM_ARKIT, np.float32)
        arkit[[ARKIT_INDEX[name] for name in shapes]] = 1.0
        vertices = self._head.vertices(arkit)
        normals = self._head.normals(vertices)
        sky, weight = np.zeros(len(vertices)), np.full(len(vertices), 1e-6)
        for direction in _sphere(DOME_DIRECTIONS):
            # Light from above counts more: a dome, not a fog.
            facing = np.maximum(normals @ direction, 0.0) * (0.65 + 0.35 * direction[1])
            sky += facing * self._lit(vertices, normals, direction)
            weight += facing
        disc = _softbox(KEY_DIRECTIONS)
        key = np.mean([self._lit(vertices, normals, direction) for direction in disc], axis=0)
        light = np.stack([sky / weight, key], 1)
        count = np.maximum(self._neighbours.sum(1), 1)[:, None]
        for _ in range(SOFTENED):
            light = 0.5 * light + 0.5 * (self._neighbours @ light) / count
        return light.astype(np.float32)

    def _lit(self, vertices: FloatArray, normals: FloatArray, direction: Float64Array) -> BoolArray:
        """Which vertices see light from a direction (towards the light, unit length). ``[V]``."""
        up = np.array([0.0, 0.0, 1.0]) if abs(direction[1]) > 0.9 else np.array([0.0, 1.0, 0.0])
        right = np.cross(up, direction)
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(direction, right), -direction])
        axes /= 0.5 * self._span_m
        clip = np.eye(4, dtype=np.float32)
        clip[:3, :3] = axes
        clip[:3, 3] = -axes @ self._centre_m
        depth = self._draw_depth(vertices, clip, DEPTH_MAP_SIZE)
        lifted = vertices + LIFT_M * normals
        seen = lifted @ clip[:3, :3].T + clip[:3, 3]
        texel = ((seen[:, :2] * 0.5 + 0.5) * DEPTH_MAP_SIZE).astype(int)
        column, row = np.clip(texel, 0, DEPTH_MAP_SIZE - 1).T
        return 0.5 + 0.5 * seen[:, 2] <= depth[row, column] + BIAS_M / self._span_m

    def at(self, arkit: FloatArray) -> FloatArray:
        """Share of dome and key light that reaches each vertex. float32 ``[V, 2]``."""
        shares = [np.mean([arkit[ARKIT_INDEX[name]] for name in names]) for names in self._poses]
        weights = np.clip(np.array(shares, np.float32), 0, 1)
        mixed = self._rest + (weights @ self._changes).reshape(self._rest.shape)
        return np.clip(mixed, 0.0, 1.0)


def _sphere(count: int) -> Float64Array:
    """Even directions over the sphere. ``[n, 3]``."""
    k = np.arange(count) + 0.5
    y = 1 - 2 * k / count
    turn, ring = np.pi * (1 + 5**0.5) * k, np.sqrt(1 - y * y)
    return np.stack([ring * np.cos(turn), y, ring * np.sin(turn)], 1)


def _softbox(count: int) -> Float64Array:
    """Even directions over the key light's disc. ``[n, 3]``."""
    a = np.cross(KEY_DIRECTION, [0.0, 1.0, 0.0])
    a /= np.linalg.norm(a)
    b = np.cross(KEY_DIRECTION, a)
    k = np.arange(count) + 0.5
    reach, spin = KEY_SPREAD * np.sqrt(k / count), np.pi * (1 + 5**0.5) * k
    disc = KEY_DIRECTION + reach[:, None] * (np.cos(spin)[:, None] * a + np.sin(spin)[:, None] * b)
    return disc / np.linalg.norm(disc, axis=1, keepdims=True)
