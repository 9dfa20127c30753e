"""Who sits where, and from where one looks: pure geometry, no GPU.

World: metres, +y up. The viewer of a call sits on the +z side and looks towards -z; the middle seat
is the origin. Seats lie on an arc around the viewer, everybody facing them, in order from left to
right.

    seats = arrange_seats(len(faces))
    placement = Placement(slot=..., world_from_head=head_matrix(seats[0], rotation, translation_m))
    camera = view_camera(ViewState(), len(faces), width, height)
    direction = view_direction(placement.world_from_head, camera.centre_m)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pica_core.camera import Camera, look_at

FloatArray = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]

SEAT_SPACING_M = 0.25
"""Along the arc, between neighbours: the paper's row of five."""
SEAT_RADIUS_M = 1.1
"""From the viewer to each seat: where people sit when they talk (chosen; 0.7 to 1.2 m is usual)."""
VERTICAL_FOV = math.radians(32)
"""Of the viewer's camera (chosen: little perspective distortion at the outer seats)."""
HEAD_HALF_WIDTH_M = 0.115
HEAD_HALF_HEIGHT_M = 0.165
"""What is framed around each seat: a head with room for its movements."""
FRAME_FILL = 0.88
"""Part of the image that the framed heads may fill."""
LABEL_FILL = 0.14
"""Part of the image height kept free below the heads, for names."""
NEAR_M = 0.02
FAR_M = 20.0

MAX_PITCH = math.radians(80)
MIN_ZOOM, MAX_ZOOM = 0.25, 12.0
ORBIT_PER_PIXEL = 0.005
"""Radians (chosen: half a turn is a drag over 630 pixels)."""
ZOOM_PER_STEP = 1.1
"""Distance ratio of one notch of the wheel."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewState:
    """What the user has done to the view. Angles in radians, about the middle seat."""

    yaw: float = 0.0
    """Positive moves the camera to the right, +x."""
    pitch: float = 0.0
    """Positive moves the camera up."""
    zoom: float = 1.0
    """The camera's distance is the framing distance divided by this."""

    def orbited(self, right_px: float, down_px: float) -> ViewState:
        """The view after dragging the scene by so many pixels."""
        pitch = self.pitch + down_px * ORBIT_PER_PIXEL
        yaw = math.remainder(self.yaw - right_px * ORBIT_PER_PIXEL, 2 * math.pi)
        return replace(self, yaw=yaw, pitch=min(max(pitch, -MAX_PITCH), MAX_PITCH))

    def zoomed(self, steps: float) -> ViewState:
        """The view after turning the wheel; positive comes closer."""
        zoom = self.zoom * ZOOM_PER_STEP ** min(max(steps, -50.0), 50.0)
        return replace(self, zoom=min(max(zoom, MIN_ZOOM), MAX_ZOOM))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Placement:
    """One head of a drawn frame."""

    slot: str
    """Which avatar of the renderer."""
    world_from_head: FloatArray
    """Head frame to world, float32 ``[4, 4]`` for column vectors."""
    fade: float = 0.0
    """0 is as it is, 1 has faded into the room: for stale faces."""


def arrange_seats(count: int) -> list[Float64Array]:
    """Seat frames, left to right as the viewer sees them.

    Returns:
        World-from-seat matrices, float64 ``[4, 4]``: +z of each seat points at the viewer, +y up.
    """
    seats = []
    for index in range(count):
        angle = (index - (count - 1) / 2) * SEAT_SPACING_M / SEAT_RADIUS_M
        sine, cosine = math.sin(angle), math.cos(angle)
        seats.append(
            np.array(
                [
                    [cosine, 0, -sine, SEAT_RADIUS_M * sine],
                    [0, 1, 0, 0],
                    [sine, 0, cosine, SEAT_RADIUS_M * (1 - cosine)],
                    [0, 0, 0, 1],
                ]
            )
        )
    return seats


def rotation_matrix(rotation: npt.ArrayLike) -> Float64Array:
    """Rotation vector (axis times angle, radians) ``[3]`` to a matrix, float64 ``[3, 3]``:
    Rodrigues."""
    vector = np.asarray(rotation, np.float64)
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turned: Float64Array = (
        np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * np.matmul(cross, cross)
    )
    return turned


def head_matrix(
    world_from_seat: Float64Array, rotation: npt.ArrayLike, translation_m: npt.ArrayLike
) -> FloatArray:
    """Where a head is: its seat, moved and turned by the tracked pose. float32 ``[4, 4]``."""
    seat_from_head = np.eye(4)
    seat_from_head[:3, :3] = rotation_matrix(rotation)
    seat_from_head[:3, 3] = np.asarray(translation_m, np.float64)
    world_from_head: FloatArray = np.matmul(world_from_seat, seat_from_head).astype(np.float32)
    return world_from_head


def view_direction(world_from_head: FloatArray, camera_centre_m: npt.ArrayLike) -> FloatArray:
    """Camera centre as seen from the head: unit length, head frame. float32 ``[3]``.

    From the middle of the head itself there is no direction; straight ahead is returned.
    """
    rotation = world_from_head[:3, :3].astype(np.float64)
    towards = np.asarray(camera_centre_m, np.float64) - world_from_head[:3, 3]
    seen = np.matmul(rotation.T, towards)
    length = float(np.linalg.norm(seen))
    if length < 1e-9:
        return np.array([0, 0, 1], np.float32)
    direction: FloatArray = (seen / length).astype(np.float32)
    return direction


def framing_distance_m(count: int, aspect: float) -> float:
    """How far before the middle seat the camera sees all seats, names included."""
    tangent = math.tan(VERTICAL_FOV / 2)
    half_height = tangent * (FRAME_FILL - LABEL_FILL)
    distance = 0.0
    for seat in arrange_seats(max(count, 1)):
        x, z = abs(float(seat[0, 3])), float(seat[2, 3])
        wide = (x + HEAD_HALF_WIDTH_M) / (tangent * aspect * FRAME_FILL)
        distance = max(distance, z + max(wide, HEAD_HALF_HEIGHT_M / half_height))
    return distance


def view_camera(view: ViewState, count: int, width: int, height: int) -> Camera:
    """The viewer's camera: frames `count` seats, then orbits and zooms as the user wants.

    It looks a little below the heads' middle, so that the names have room.
    """
    distance = framing_distance_m(count, width / height) / view.zoom
    focus = np.array([0.0, -distance * math.tan(VERTICAL_FOV / 2) * LABEL_FILL / 2, 0.0])
    direction = np.array(
        [
            math.sin(view.yaw) * math.cos(view.pitch),
            math.sin(view.pitch),
            math.cos(view.yaw) * math.cos(view.pitch),
        ]
    )
    return look_at(
        name="viewer",
        centre_m=focus + distance * direction,
        target_m=focus,
        vertical_fov=VERTICAL_FOV,
        width=width,
        height=height,
    )


def clip_from_head(camera: Camera, world_from_head: FloatArray) -> FloatArray:
    """The matrix for one head and one camera, float32 ``[4, 4]`` for column vectors."""
    matrix: FloatArray = np.matmul(camera.clip_from_world(NEAR_M, FAR_M), world_from_head)
    return matrix


def screen_rect(
    matrix: FloatArray, low_m: npt.ArrayLike, high_m: npt.ArrayLike
) -> tuple[float, float, float, float] | None:
    """The part of the screen that a box may cover.

    Args:
        matrix: Clip space from the box's frame, ``[4, 4]``.
        low_m: Lower corner ``[3]``.
        high_m: Upper corner ``[3]``.

    Returns:
        Left, bottom, right, top in clip space, within [-1, 1]; None if nothing is on the screen. A
        box that reaches behind the near plane may cover everything.
    """
    low, high = np.asarray(low_m, np.float64), np.asarray(high_m, np.float64)
    picks = (np.arange(8)[:, None] >> np.arange(3)) & 1
    corners = np.where(picks == 1, high, low)
    clip = np.matmul(corners, matrix[:, :3].T.astype(np.float64)) + matrix[:, 3]
    w = clip[:, 3]
    if not np.isfinite(clip).all() or (w <= NEAR_M).all():
        return None
    if (w <= NEAR_M).any():
        return (-1.0, -1.0, 1.0, 1.0)
    places = clip[:, :2] / w[:, None]
    left, bottom = np.clip(places.min(axis=0), -1, 1).tolist()
    right, top = np.clip(places.max(axis=0), -1, 1).tolist()
    if left >= right or bottom >= top:
        return None
    return (left, bottom, right, top)


def label_anchor_px(camera: Camera, world_from_head: FloatArray) -> tuple[float, float] | None:
    """Where a head's name belongs: image pixels (x right, y down) below the chin; None if
    behind."""
    chin = world_from_head[:3, 3].astype(np.float64) - [0.0, HEAD_HALF_HEIGHT_M, 0.0]
    pixel, depth = camera.project(chin)
    if depth <= NEAR_M:
        return None
    return float(pixel[0]), float(pixel[1])
