"""Self-shadowing: how much of the dome, and of the key light, reaches each vertex.

Measured once per identity by depth maps from many directions, at rest and at a few strong
expressions; a pose takes a mix of them. Soft shadow of nose, brows, hair and lips thus moves with
the face at no cost per frame. What it does not
know: shadow of combinations that no single expression has.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from pica_core.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.capture.heads import Head
from pica_core.capture.layout import EYE_ROW
from pica_core.capture.skin import smoothstep

FloatArray = npt.NDArray[np.float32]
DrawDepth = Callable[[FloatArray, FloatArray, int], FloatArray]

KEY_DIRECTION = np.array([0.50, 0.55, 0.80]) / np.linalg.norm([0.50, 0.55, 0.80])
"""Must agree with shaders/stage.frag."""
DOME_DIRECTIONS = 32
KEY_DIRECTIONS = 7
KEY_SPREAD = 0.22
"""Half angle of the key light, radians: a softbox, so shadows have soft edges."""
SMOOTHING = 2
"""Passes of averaging over neighbours."""
MAP_SIZE = 192
SPAN_M = 0.36
BIAS_M = 0.0022
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


def _orthographic(direction: npt.NDArray[np.float64]) -> FloatArray:
    """Clip matrix that looks against `direction` at the head's middle."""
    up = np.array([0.0, 0.0, 1.0]) if abs(direction[1]) > 0.9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    rows = np.stack([right, np.cross(direction, right), -direction]) / (0.5 * SPAN_M)
    centre = np.array([0.0, -0.01, 0.0])
    clip = np.eye(4, dtype=np.float32)
    clip[:3, :3] = rows
    clip[:3, 3] = -rows @ centre
    return clip


def _directions() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Even directions over the sphere, and a disc of directions around the key light."""
    k = np.arange(DOME_DIRECTIONS) + 0.5
    y = 1 - 2 * k / DOME_DIRECTIONS
    turn = np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - y * y)
    sphere = np.stack([ring * np.cos(turn), y, ring * np.sin(turn)], -1)
    a = np.cross(KEY_DIRECTION, [0.0, 1.0, 0.0])
    a /= np.linalg.norm(a)
    b = np.cross(KEY_DIRECTION, a)
    j = np.arange(KEY_DIRECTIONS) + 0.5
    reach = KEY_SPREAD * np.sqrt(j / KEY_DIRECTIONS)
    spin = np.pi * (1 + 5**0.5) * j
    disc = KEY_DIRECTION + reach[:, None] * (np.cos(spin)[:, None] * a + np.sin(spin)[:, None] * b)
    return sphere, disc / np.linalg.norm(disc, axis=1, keepdims=True)


def shade_eyes(head: Head, vertices: FloatArray, shade: FloatArray) -> None:
    """Darken the eyeballs under lids and lashes, in place: lids are thinner than a shadow map sees.

    Args:
        head: The head.
        vertices: Its posed vertices, metres. ``[V, 3]``.
        shade: Share of dome and key light. ``[V, 2]``.
    """
    chart = head.charts["skin"]
    grid = vertices[chart.span].reshape(*chart.shape, 3)
    row = int(np.flatnonzero(chart.rows == EYE_ROW)[0])
    for side, name in ((1.0, "eye_left"), (-1.0, "eye_right")):
        span = head.charts[name].span
        upper, lower = grid[row], grid[row + 1]
        front = (side * upper[:, 0] > 0.005) & (upper[:, 2] > 0.06)
        order = np.argsort(upper[front, 0])
        x, y = vertices[span, 0], vertices[span, 1]
        above = np.interp(x, upper[front, 0][order], upper[front, 1][order]) - y
        order = np.argsort(lower[front, 0])
        below = y - np.interp(x, lower[front, 0][order], lower[front, 1][order])
        open_above = 0.25 + 0.75 * smoothstep(-0.0005, 0.0042, above)
        open_below = 0.60 + 0.40 * smoothstep(-0.0005, 0.0022, below)
        shade[span] *= (open_above * open_below)[:, None].astype(np.float32)


class Occlusion:
    """Shadow of one head as a function of its expression.

    Args:
        head: The head.
        draw_depth: Draws a depth map (`StageRenderer`).
    """

    def __init__(self, head: Head, draw_depth: DrawDepth) -> None:
        self._head = head
        self._draw_depth = draw_depth
        zero = np.zeros(NUM_ARKIT, np.float32)
        self._rest = self._measure(zero)
        changes = []
        for names in POSES:
            arkit = zero.copy()
            arkit[[ARKIT_INDEX[name] for name in names]] = 1.0
            changes.append(self._measure(arkit) - self._rest)
        self._changes = np.stack(changes).reshape(len(POSES), -1)

    def _measure(self, arkit: FloatArray) -> FloatArray:
        vertices = self._head.vertices(arkit)
        normals = self._head.normals(vertices)
        sphere, disc = _directions()
        sky = np.zeros(len(vertices))
        sky_weight = np.full(len(vertices), 1e-6)
        for direction in sphere:
            facing = np.maximum(normals @ direction, 0.0)
            # Light from above counts more: a dome, not a fog.
            facing = facing * (0.65 + 0.35 * direction[1])
            sky += facing * self._visible(vertices, normals, direction)
            sky_weight += facing
        key = np.mean([self._visible(vertices, normals, direction) for direction in disc], 0)
        return self._smoothed(np.stack([sky / sky_weight, key], -1)).astype(np.float32)

    def _smoothed(self, shade: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Shadow averaged over neighbours in each chart: its edges are soft, the mesh is coarse."""
        for chart in self._head.charts.values():
            grid = shade[chart.span].reshape(*chart.shape, 2)
            for _ in range(SMOOTHING):
                for axis in (0, 1):
                    ends = "wrap" if axis == 1 and chart.name == "skin" else "edge"
                    pads = [(1, 1) if k == axis else (0, 0) for k in range(3)]
                    wide = np.pad(grid, pads, mode=ends)  # type: ignore[call-overload]
                    low, high = (
                        np.take(wide, range(grid.shape[axis]), axis),
                        np.take(wide, range(2, grid.shape[axis] + 2), axis),
                    )
                    grid = 0.5 * grid + 0.25 * (low + high)
            shade[chart.span] = grid.reshape(-1, 2)
        return shade

    def _visible(
        self, vertices: FloatArray, normals: FloatArray, direction: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        clip = _orthographic(direction)
        depth = self._draw_depth(vertices, clip, MAP_SIZE)
        lifted = vertices + 0.0015 * normals
        seen = lifted @ clip[:3, :3].T + clip[:3, 3]
        at = np.clip(((seen[:, :2] * 0.5 + 0.5) * MAP_SIZE).astype(int), 0, MAP_SIZE - 1)
        nearest = depth[at[:, 1], at[:, 0]]
        lit: npt.NDArray[np.float64] = (0.5 + 0.5 * seen[:, 2] <= nearest + BIAS_M / SPAN_M).astype(
            np.float64
        )
        return lit

    def at(self, arkit: FloatArray) -> FloatArray:
        """Share of dome and key light that reaches each vertex. float32 ``[V, 2]``."""
        weights = np.array(
            [np.mean([arkit[ARKIT_INDEX[name]] for name in names]) for names in POSES], np.float32
        )
        mixed = self._rest + (np.clip(weights, 0, 1) @ self._changes).reshape(self._rest.shape)
        result: FloatArray = np.clip(mixed, 0.0, 1.0)
        return result
