"""Shadow of a head on itself: how much of the dome, and of the key light, reaches each vertex.

Measured once per head by depth maps from many directions, at rest and at a few strong expressions;
a pose takes a mix of them. So soft shadow of nose, brows, hair and lips moves with the face at no
cost per frame. What it does not know: shadow of combinations that no single expression has.
"""

from collections.abc import Callable, Container
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array

from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES, NUM_ARKIT
from pica_core.capture.triangles import edges
from pica_core.types import BoolArray, Float64Array, FloatArray, IntArray

DrawDepth = Callable[[FloatArray, FloatArray, int], FloatArray]
"""Draws a depth map of vertices along a clip matrix, so many texels wide."""

KEY_DIRECTION = np.array([0.50, 0.55, 0.80]) / np.linalg.norm([0.50, 0.55, 0.80])
"""Must agree with shaders/stage.frag."""
KEY_SPREAD = 0.22
"""Half angle of the key light, radians: a softbox, so shadows have soft edges."""
SOFTENED = 2
"""How often a vertex takes half of its neighbours' light: no shadow is a saw of triangles."""
DEPTH_MAP_SIZE = 192
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


class PosedMesh(Protocol):
    """A head that 52 ARKit values move."""

    def vertices(self, arkit: npt.ArrayLike) -> FloatArray:
        """Vertices of a pose, head frame, metres. float32 ``[V, 3]``."""

    def normals(self, vertices: FloatArray) -> FloatArray:
        """Unit normals of posed vertices. float32 ``[V, 3]``."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ShadowPlan:
    """How finely a head's shadow is measured."""

    dome_directions: int
    """Directions of the dome's light."""
    key_directions: int
    """Directions within the key light's disc."""
    span_m: float
    """Width of the depth maps, metres."""
    centre_m: tuple[float, float, float]
    """What the depth maps are aimed at, head frame, metres."""
    drivers: Container[str] = ARKIT_NAMES
    """Shapes that the head has; expressions of others are not measured."""


class Occlusion:
    """Shadow of one head as a function of its expression."""

    def __init__(
        self, head: PosedMesh, faces: IntArray, draw_depth: DrawDepth, plan: ShadowPlan
    ) -> None:
        self._head, self._draw_depth, self._plan = head, draw_depth, plan
        ends = edges(faces).T
        self._neighbours = coo_array((np.ones(ends.shape[1]), tuple(ends))).tocsr()
        self._neighbours += self._neighbours.T
        self._poses = [p for p in POSES if all(name in plan.drivers for name in p)]
        self._rest = self._measure(())
        changes = [self._measure(names) - self._rest for names in self._poses]
        self._changes = np.array(changes, np.float32).reshape(len(changes), self._rest.size)

    def _measure(self, shapes: tuple[str, ...]) -> FloatArray:
        arkit = np.zeros(NUM_ARKIT, np.float32)
        arkit[[ARKIT_INDEX[name] for name in shapes]] = 1.0
        vertices = self._head.vertices(arkit)
        normals = self._head.normals(vertices)
        sky, weight = np.zeros(len(vertices)), np.full(len(vertices), 1e-6)
        for direction in _sphere(self._plan.dome_directions):
            # Light from above counts more: a dome, not a fog.
            facing = np.maximum(normals @ direction, 0.0) * (0.65 + 0.35 * direction[1])
            sky += facing * self._lit(vertices, normals, direction)
            weight += facing
        disc = _softbox(self._plan.key_directions)
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
        axes /= 0.5 * self._plan.span_m
        clip = np.eye(4, dtype=np.float32)
        clip[:3, :3] = axes
        clip[:3, 3] = -axes @ np.array(self._plan.centre_m)
        depth = self._draw_depth(vertices, clip, DEPTH_MAP_SIZE)
        lifted = vertices + LIFT_M * normals
        seen = lifted @ clip[:3, :3].T + clip[:3, 3]
        texel = ((seen[:, :2] * 0.5 + 0.5) * DEPTH_MAP_SIZE).astype(int)
        column, row = np.clip(texel, 0, DEPTH_MAP_SIZE - 1).T
        return 0.5 + 0.5 * seen[:, 2] <= depth[row, column] + BIAS_M / self._plan.span_m

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
