"""The dome: cameras on a section of a sphere around the front of a head.

Five evaluation views bear names (front, up, down, left, right; left is the camera on the subject's
left). The other cameras fill the section evenly, and every sixth one looks at the mouth from
nearby.
"""

from __future__ import annotations

import numpy as np

from pica_core.camera import Camera, look_at

EVALUATION_VIEWS: dict[str, tuple[float, float]] = {
    "front": (0.0, 0.0),
    "up": (0.0, 32.0),
    "down": (0.0, -28.0),
    "left": (52.0, 4.0),
    "right": (-52.0, 4.0),
}
"""Azimuth towards the subject's left and elevation of the paper's five views, degrees."""
HEAD_TARGET_M = (0.0, -0.008, 0.02)
"""What the cameras look at: a little below and ahead of the ear axis."""
MOUTH_TARGET_M = (0.0, -0.045, 0.085)
DISTANCE_M = 1.0
HEAD_SPAN_M = 0.35
"""What the shorter side of the image covers at the target."""
MOUTH_SPAN_M = 0.12


def _camera(
    name: str, azimuth: float, elevation: float, *, mouth: bool, width: int, height: int
) -> Camera:
    a, e = np.radians(azimuth), np.radians(elevation)
    target = np.array(MOUTH_TARGET_M if mouth else HEAD_TARGET_M)
    away = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    span = (MOUTH_SPAN_M if mouth else HEAD_SPAN_M) * height / min(width, height)
    return look_at(
        name=name,
        centre_m=target + DISTANCE_M * away,
        target_m=target,
        vertical_fov=2 * np.arctan(0.5 * span / DISTANCE_M),
        width=width,
        height=height,
    )


def dome_cameras(count: int, width: int, height: int) -> tuple[Camera, ...]:
    """The first `count` cameras of the dome: front, left, right, up, down, mouth, then an even
    filling.

    Args:
        count: At least 1.
        width: Image columns, pixels.
        height: Image rows, pixels.
    """
    plan: list[tuple[str, float, float, bool]] = [
        (name, *EVALUATION_VIEWS[name], False) for name in ("front", "left", "right", "up", "down")
    ]
    plan.append(("mouth", 0.0, -4.0, True))
    golden = 0.618033988749895
    for index in range(max(count - len(plan), 0)):
        # Low-discrepancy filling of azimuth and elevation; more cameras leave the first ones where
        # they are.
        azimuth = -75.0 + 150.0 * ((0.5 + index * golden) % 1.0)
        elevation = -30.0 + 66.0 * ((0.25 + index * 0.7548776662466927) % 1.0)
        mouth = index % 6 == 5
        if mouth:
            azimuth, elevation = 0.5 * azimuth, 0.5 * elevation
        plan.append((f"dome{index:02d}", azimuth, elevation, mouth))
    return tuple(
        _camera(name, azimuth, elevation, mouth=mouth, width=width, height=height)
        for name, azimuth, elevation, mouth in plan[:count]
    )
