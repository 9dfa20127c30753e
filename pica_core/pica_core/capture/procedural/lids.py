"""Eyelids: they slide over the eyeball, they are never pushed through it.

A lid vertex keeps its distance from the nose (`u`) and its place between margin and fold; what
moves is the height of the margin. Depth then follows from the `EyeSurface`. So a blink is a sweep
over a sphere, and any sum of blink, squint, wide and gaze is safe.
"""

from dataclasses import dataclass

import numpy as np

from pica_core.capture.procedural.identity import FaceShape
from pica_core.capture.procedural.layout import EYE_ROW, Chart
from pica_core.capture.procedural.skin import (
    CREASE_ROW,
    LID_THICKNESS,
    LOWER_FOLD_ROW,
    EyeSurface,
    Skin,
    lid_lines,
    smoothstep,
)
from pica_core.types import Float64Array, Int64Array

CLOSED_AT = 0.16
"""Where the lids meet: at this share of the opening above the lower lid."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LidPose:
    """What one eye's lids do; every value may be a batch ``[N]``."""

    blink: Float64Array
    """0 open to 1 closed."""
    wide: Float64Array
    """0 to 1, upper lid raised."""
    squint: Float64Array
    """0 to 1, lower lid raised."""
    pitch: Float64Array
    """Gaze, radians, positive upwards: lids follow the eye."""


class Lids:
    """The lids of one eye as a function of their pose."""

    def __init__(
        self, face: FaceShape, surface: EyeSurface, skin: Skin, chart: Chart, side: float
    ) -> None:
        points = skin.points
        rows = np.broadcast_to(chart.rows[:, None], points.shape[:2])
        u = side * points[..., 0] - surface.centre[0]
        inner, outer = (corner - surface.centre[0] for corner in skin.eye_corners)
        weight = smoothstep(CREASE_ROW - 6, CREASE_ROW + 3, rows)
        weight = weight * smoothstep(LOWER_FOLD_ROW + 7, LOWER_FOLD_ROW - 4, rows)
        weight = (
            weight * smoothstep(inner - 5.5, inner - 0.5, u) * smoothstep(outer + 8, outer + 0.5, u)
        )
        chosen = (weight > 1e-4) & (points[..., 2] > 40)
        self.index: Int64Array = np.flatnonzero(chosen)
        self.weight = weight[chosen]
        self._surface = surface
        self._u = u[chosen]
        self._side = side
        row = rows[chosen].astype(np.float64)
        self._is_upper = row <= EYE_ROW
        upper, lower = lid_lines(face, skin.eye_corners, self._u)
        self._upper, self._lower = upper, lower
        margin = np.where(self._is_upper, upper, lower)
        fold_row = np.where(self._is_upper, CREASE_ROW, LOWER_FOLD_ROW)
        edge_row = np.where(self._is_upper, EYE_ROW, EYE_ROW + 1)
        # 0 at the margin, 1 at the fold, beyond 1 outside the lid.
        self._place = np.abs(row - edge_row) / np.abs(fold_row - edge_row)
        self._offset = points[..., 1][chosen] - margin
        # The wet edge: the first row lies on the eyeball, the next one is the lid's outer edge.
        steps = np.abs(row - edge_row)
        thickness = np.interp(steps, [0, 1, 3, 10], [0.45, 1.2, LID_THICKNESS, LID_THICKNESS + 0.5])
        # Beside the slit there is no edge; above it a crease sets the lid off from its fold.
        beside = smoothstep(0.0, 2.5, np.maximum(inner - self._u, self._u - outer))
        crease = 0.8 * np.exp(-0.5 * ((self._place - 0.95) / 0.16) ** 2)
        along = smoothstep(inner - 1.0, inner + 6.0, self._u)
        along = along * smoothstep(outer + 4.0, outer - 4.0, self._u)
        thickness = thickness - np.where(self._is_upper, crease * along, 0.0)
        self._thickness = thickness + beside * (LID_THICKNESS + 0.3 - thickness)
        self._opening = np.maximum(upper - lower, 0.0)
        self._slide = np.clip(1.0 - self._place, 0.0, 1.0) ** 0.8
        self._at_edge = smoothstep(1.6, 0.2, steps) * smoothstep(0.3, 2.5, self._opening)

    def margins(self, pose: LidPose) -> tuple[Float64Array, Float64Array]:
        """Heights of the upper and lower margin at every lid vertex, mm. Two ``[N, L]``."""
        blink = np.clip(pose.blink, 0.0, 1.0)[:, None]
        wide, squint = np.clip(pose.wide, 0, 1)[:, None], np.clip(pose.squint, 0, 1)[:, None]
        pitch = pose.pitch[:, None]
        opening = self._opening
        meet = self._lower + CLOSED_AT * opening
        shape = opening / 10.0  # corners do not move
        upper = self._upper + shape * (
            2.4 * wide - 0.5 * squint + 5.5 * np.minimum(pitch, 0.0) + 2.6 * np.maximum(pitch, 0)
        )
        lower = self._lower + shape * (2.2 * squint + 2.2 * np.minimum(pitch, 0.0) - 0.4 * wide)
        upper = upper + blink * (meet - upper)
        lower = lower + blink * (meet - lower)
        middle = 0.5 * (upper + lower)
        crossed = lower > upper
        return np.where(crossed, middle, upper), np.where(crossed, middle, lower)

    def points(self, pose: LidPose) -> Float64Array:
        """Lid vertices, head frame, mm. float64 ``[N, L, 3]``; blend with `weight`."""
        upper, lower = self.margins(pose)
        shift = np.where(self._is_upper, upper - self._upper, lower - self._lower)
        rest = np.where(self._is_upper, self._upper, self._lower)
        y = rest + self._offset + shift * self._slide
        # Closed lids overlap by a quarter of a millimetre, so that no eye shines through.
        closed = np.clip(pose.blink, 0.0, 1.0)[:, None] ** 4
        y = y - 0.25 * closed * self._at_edge * self._is_upper
        z = self._surface.depth(self._u, y, self._thickness)
        x = np.broadcast_to(self._side * (self._surface.centre[0] + self._u), y.shape)
        return np.stack([x, y, z], -1)
