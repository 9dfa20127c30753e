"""Self-shadowing: how much of the dome, and of the key light, reaches each vertex.

Measured once per identity by depth maps from many directions, at rest and at a few strong
expressions; a pose takes a mix of them. Soft shadow of nose, brows, hair and lips thus moves with
the face at no cost per frame. What it does not
know: shadow of combinations that no single expression has.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.capture.lighting.shadow import POSES, DrawDepth, lit, softbox, sphere
from pica_core.capture.procedural.heads import ProceduralHead
from pica_core.capture.procedural.layout import EYE_ROW
from pica_core.capture.procedural.skin import smoothstep
from pica_core.types import FloatArray

DOME_DIRECTIONS = 32
KEY_DIRECTIONS = 7
SMOOTHING = 2
"""Passes of averaging over neighbours."""
SPAN_M, CENTRE_M = 0.36, (0.0, -0.01, 0.0)
"""Of the depth maps."""


def shade_eyes(head: ProceduralHead, vertices: FloatArray, shade: FloatArray) -> None:
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
        draw_depth: Draws a depth map (`ProceduralRenderer`).
    """

    def __init__(self, head: ProceduralHead, draw_depth: DrawDepth) -> None:
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
        sky = np.zeros(len(vertices))
        sky_weight = np.full(len(vertices), 1e-6)
        for direction in sphere(DOME_DIRECTIONS):
            facing = np.maximum(normals @ direction, 0.0)
            # Light from above counts more: a dome, not a fog.
            facing = facing * (0.65 + 0.35 * direction[1])
            sky += facing * self._visible(vertices, normals, direction)
            sky_weight += facing
        disc = softbox(KEY_DIRECTIONS)
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
    ) -> npt.NDArray[np.bool_]:
        return lit(self._draw_depth, vertices, normals, direction, span_m=SPAN_M, centre_m=CENTRE_M)

    def at(self, arkit: FloatArray) -> FloatArray:
        """Share of dome and key light that reaches each vertex. float32 ``[V, 2]``."""
        weights = np.array(
            [np.mean([arkit[ARKIT_INDEX[name]] for name in names]) for names in POSES], np.float32
        )
        mixed = self._rest + (np.clip(weights, 0, 1) @ self._changes).reshape(self._rest.shape)
        result: FloatArray = np.clip(mixed, 0.0, 1.0)
        return result
