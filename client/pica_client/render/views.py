"""The viewer's cameras: turned and moved closer by hand, one or one for each eye. Pure geometry.

The two eyes' cameras look the same way, half an eye distance to the left and to the right of the
one in the middle, with their pictures shifted so that what lies as far away as the seats is at the
same place in both: it appears at the depth of the screen, and nothing is turned inwards (which
would shift pixels up and down between the eyes).
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace
from functools import lru_cache

import numpy as np

from pica_client.render.seats import VERTICAL_FOV, SeatPlan
from pica_core.avatar.manifest import ViewSpan
from pica_core.camera import Camera, look_at
from pica_core.types import Float64Array

USUAL_SPAN = ViewSpan(-60.0, 60.0, -30.0, 36.0)
"""The directions of our own captures, for an avatar whose file does not say its own."""
KEPT_DEGREES = 4.0
"""Kept free of what an avatar was seen from, as people turn their heads themselves (chosen: hair at
the far side tears 10 degrees beyond)."""
MAX_YAW, MAX_PITCH = 70, 50
"""Degrees that a view turns at most, whatever avatars can show (chosen: the room has no back)."""
NEAREST_M = 0.3
"""The camera stays so far from the middle of any head: hair, nose, movements lie within 0.2."""
MIN_ZOOM, MAX_ZOOM = 0.4, 12.0
ORBIT_PER_PIXEL = 0.005
"""Radians (chosen: half a turn is a drag over 630 pixels)."""
ZOOM_PER_STEP = 1.1
"""Distance ratio of one notch of the wheel."""


@dataclass(frozen=True, kw_only=True, slots=True)
class OrbitLimits:
    """How far a view may turn, radians about the middle of the seats; see `ViewState`."""

    min_yaw: float = -math.radians(45)
    max_yaw: float = math.radians(45)
    min_pitch: float = -math.radians(26)
    max_pitch: float = math.radians(26)

    def clamped(self, view: ViewState) -> ViewState:
        """Return the view, turned no further than it may."""
        return replace(
            view,
            yaw=min(max(view.yaw, self.min_yaw), self.max_yaw),
            pitch=min(max(view.pitch, self.min_pitch), self.max_pitch),
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewState:
    """What the user has done to the view. Angles in radians, about the middle of the seats."""

    yaw: float = 0.0
    """Positive moves the camera to the right, +x."""
    pitch: float = 0.0
    """Positive moves the camera up."""
    zoom: float = 1.0
    """The camera's way to the nearest place before the heads is divided by this; below 1 its
    distance."""

    def orbited(self, right_px: float, down_px: float) -> ViewState:
        """The view after dragging the scene by so many pixels."""
        yaw, pitch = -right_px * ORBIT_PER_PIXEL, down_px * ORBIT_PER_PIXEL
        return replace(self, yaw=self.yaw + yaw, pitch=self.pitch + pitch)

    def zoomed(self, steps: float) -> ViewState:
        """The view after turning the wheel; positive comes closer."""
        zoom = self.zoom * ZOOM_PER_STEP ** min(max(steps, -50.0), 50.0)
        return replace(self, zoom=min(max(zoom, MIN_ZOOM), MAX_ZOOM))


@lru_cache(maxsize=8)
def orbit_limits(plan: SeatPlan, spans: tuple[ViewSpan, ...]) -> OrbitLimits:
    """How far the view may turn before a person is seen from where their avatar was not trained,
    which is torn there: of each seat `spans` says from where. One that is beyond that already may
    not get further. A turn about the middle counts as one about each head."""
    low, high = np.array([[-MAX_YAW, -MAX_PITCH], [MAX_YAW, MAX_PITCH]], np.float64)
    for seat, span in zip(plan.seats, spans, strict=True):
        x, y, z = np.matmul(plan.camera_m - seat[:3, 3], seat[:3, :3])
        home = np.degrees([math.atan2(x, z), math.atan2(y, math.hypot(x, z))])
        least, most = np.array(astuple(span)).reshape(2, 2).T - home
        low = np.maximum(low, np.minimum(least + KEPT_DEGREES, 0.0))
        high = np.minimum(high, np.maximum(most - KEPT_DEGREES, 0.0))
    (min_yaw, min_pitch), (max_yaw, max_pitch) = np.radians([low, high]).tolist()
    return OrbitLimits(min_yaw=min_yaw, max_yaw=max_yaw, min_pitch=min_pitch, max_pitch=max_pitch)


def plan_camera(
    plan: SeatPlan, view: ViewState, width: int, height: int, limits: OrbitLimits | None = None
) -> Camera:
    """The viewer's camera: that of the plan, turned and moved closer as the user wants."""
    view = (limits or OrbitLimits()).clamped(view)
    offset = plan.camera_m - plan.target_m
    distance = float(np.linalg.norm(offset))
    around = math.atan2(offset[0], offset[2]) + view.yaw
    up = math.asin(offset[1] / distance) + view.pitch
    level = math.cos(up)
    direction = np.array([math.sin(around) * level, math.sin(up), math.cos(around) * level])
    # The nearer the camera comes to a head, the less a notch of the wheel moves it.
    nearest = min(_nearest_m(plan, direction), distance)
    zoom = min(max(view.zoom, MIN_ZOOM), MAX_ZOOM)
    distance = nearest + (distance - nearest) / zoom if zoom > 1 else distance / zoom
    return look_at(
        name="viewer",
        centre_m=plan.target_m + distance * direction,
        target_m=plan.target_m,
        vertical_fov=VERTICAL_FOV,
        width=width,
        height=height,
    )


def stereo_cameras(
    camera: Camera, eye_distance_m: float, screen_distance_m: float
) -> tuple[Camera, Camera]:
    """The cameras of the left and of the right eye.

    Args:
        camera: Between the eyes; of one eye's picture.
        eye_distance_m: Between the eyes, metres; 0 gives the same camera twice.
        screen_distance_m: How far before the camera things appear at the depth of the screen.
    """
    left, right = (_moved(camera, side * eye_distance_m / 2, screen_distance_m) for side in (-1, 1))
    return left, right


def _nearest_m(plan: SeatPlan, direction: Float64Array) -> float:
    """From the middle of the view along a direction to where no head is nearer than `NEAREST_M`
    from there on: the farther root of |target + t direction - head| = NEAREST_M, of all heads."""
    if not plan.seats:
        return NEAREST_M
    towards = np.array([seat[:3, 3] for seat in plan.seats]) - plan.target_m
    along = np.matmul(towards, direction)
    inside = NEAREST_M**2 - np.square(towards).sum(axis=1) + np.square(along)
    roots = along + np.sqrt(np.maximum(inside, 0.0))
    return max(float(np.where(inside > 0, roots, 0.0).max()), NEAREST_M)


def _moved(camera: Camera, right_m: float, screen_distance_m: float) -> Camera:
    """A camera that has moved to its right, its picture shifted back."""
    centre = camera.centre_m + right_m * camera.rotation[0]
    intrinsics = camera.intrinsics.copy()
    intrinsics[0, 2] += intrinsics[0, 0] * right_m / screen_distance_m
    return replace(camera, intrinsics=intrinsics, translation_m=-np.matmul(camera.rotation, centre))
