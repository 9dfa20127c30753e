"""Light on the built-in heads: soft edges of shadow, and shade of the lids on the eyeballs."""

import numpy as np

from pica_core.capture.procedural.heads import ProceduralHead
from pica_core.capture.procedural.layout import EYE_ROW, Chart
from pica_core.capture.procedural.skin import smoothstep
from pica_core.types import Float64Array, FloatArray

SMOOTHING = 2
"""Passes of averaging over neighbours."""


def soften(shade: Float64Array, charts: dict[str, Chart]) -> Float64Array:
    """Average shadow ``[V, 2]`` over neighbours in each chart, in place: the mesh is coarse."""
    for chart in charts.values():
        grid = shade[chart.span].reshape(*chart.shape, 2)
        for _ in range(SMOOTHING):
            for axis in (0, 1):
                ends = "wrap" if axis == 1 and chart.name == "skin" else "edge"
                pads = [(1, 1) if k == axis else (0, 0) for k in range(3)]
                wide = np.pad(grid, pads, mode=ends)  # type: ignore[call-overload]
                low = np.take(wide, range(grid.shape[axis]), axis)
                high = np.take(wide, range(2, grid.shape[axis] + 2), axis)
                grid = 0.5 * grid + 0.25 * (low + high)
        shade[chart.span] = grid.reshape(-1, 2)
    return shade


def shade_eyes(head: ProceduralHead, vertices: FloatArray, shade: FloatArray) -> None:
    """Darken the eyeballs under lids and lashes in place: a shadow map is too coarse for lids."""
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
