"""The dome: cameras on a section of a sphere around the front of a head.

Five evaluation views bear names (front, up, down, left, right; left is the camera on the subject's
left). Two plans fill the rest:

- ``mixed`` lenses: three more look at mouth, eyes and bust, and the others take turns at what they
  look at. Few cameras of few pixels then show small parts, too.
- ``one`` lens: all have the same lens and look at the head, as in the paper's dome of 40 cameras of
  50 mm. Where those stood is not published; ours fill the section evenly.
"""

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
AIMS: dict[str, tuple[tuple[float, float, float], float]] = {
    "head": ((0.0, -0.008, 0.02), 0.35),
    "mouth": ((0.0, -0.045, 0.085), 0.12),
    "eyes": ((0.0, 0.03, 0.075), 0.13),
    "bust": ((0.0, -0.15, 0.0), 0.40),
}
"""What a camera can look at, head frame, and what the shorter side of its image covers there,
metres."""
DISTANCE_M = 1.0
NAMED_VIEWS: tuple[tuple[str, float, float, str], ...] = (
    *((name, *EVALUATION_VIEWS[name], "head") for name in ("front", "left", "right", "up", "down")),
    ("mouth", 0.0, -4.0, "mouth"),
    ("eyes", 0.0, 2.0, "eyes"),
    ("bust", 0.0, 12.0, "bust"),
)
"""Name, azimuth, elevation (degrees) and aim of the first cameras."""
LENSES = ("mixed", "one")
FILLING_AIMS = ("head", "bust", "head", "eyes", "head", "mouth")
"""Aims of the cameras after the named ones, in turn."""


def aimed_camera(
    name: str, azimuth: float, elevation: float, aim: str, *, width: int, height: int
) -> Camera:
    """Return a camera on the dome, at so many degrees, that one of `AIMS` fills."""
    a, e = np.radians(azimuth), np.radians(elevation)
    target, reach = np.array(AIMS[aim][0]), AIMS[aim][1]
    away = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    span = reach * height / min(width, height)
    return look_at(
        name=name,
        centre_m=target + DISTANCE_M * away,
        target_m=target,
        vertical_fov=2 * np.arctan(0.5 * span / DISTANCE_M),
        width=width,
        height=height,
    )


def dome_cameras(count: int, width: int, height: int, lenses: str = "mixed") -> tuple[Camera, ...]:
    """The first `count` cameras of the dome: the named views, then an even filling; `lenses` is one
    of `LENSES`."""
    one = lenses == "one"
    plan = list(NAMED_VIEWS[: len(EVALUATION_VIEWS)] if one else NAMED_VIEWS)
    golden = 0.618033988749895
    for index in range(max(count - len(plan), 0)):
        # Low-discrepancy filling of azimuth and elevation; more cameras leave the first ones where
        # they are.
        azimuth = -75.0 + 150.0 * ((0.5 + index * golden) % 1.0)
        elevation = -30.0 + 66.0 * ((0.25 + index * 0.7548776662466927) % 1.0)
        aim = "head" if one else FILLING_AIMS[index % len(FILLING_AIMS)]
        if aim in ("mouth", "eyes"):
            azimuth, elevation = 0.5 * azimuth, 0.5 * elevation
        plan.append((f"dome{index:02d}", azimuth, elevation, aim))
    return tuple(
        aimed_camera(name, azimuth, elevation, aim, width=width, height=height)
        for name, azimuth, elevation, aim in plan[:count]
    )
