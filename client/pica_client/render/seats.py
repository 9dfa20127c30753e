"""Who sits where, and the camera that shows them all: pure geometry.

World: metres, +y up; the viewer is on the +z side and looks towards -z. Four layouts:

    line    side by side, 25 cm apart, all looking straight ahead: the paper's row of five
    arc     the same on an arc around the viewer, everybody facing the viewer
    table   around the far side of a round table, seen from a little above
    grid    rows and columns, everybody facing the viewer

In each of them one participant may be pinned: that one fills the picture, and the others look on
from a strip at its side.

    plan = plan_seats("table", 5, aspect=16 / 9)
    camera = plan_camera(plan, ViewState(), 1280, 720)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from pica_core.camera import Camera, look_at
from pica_core.types import Float64Array

Layout = Literal["line", "arc", "table", "grid"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)

SEAT_SPACING_M = 0.25
"""Between neighbours: the paper's row of five."""
SEAT_RADIUS_M = 1.1
"""From the viewer to each seat of the arc: where people sit when they talk (chosen; 0.7 to 1.2 m is
usual)."""
TABLE_SPACING_M = 0.29
"""Between neighbours at the table, as seen from the front: those at its sides are nearer and look
larger (chosen: their heads stay apart on the screen)."""
TABLE_RADIUS_M = 0.62
TABLE_PITCH = math.radians(9)
"""How far from above the table is seen (chosen: a person who sits at it)."""
VERTICAL_FOV = math.radians(32)
"""The viewer's field of view (chosen: little perspective distortion at the outer seats)."""
HEAD_HALF_WIDTH_M = 0.115
HEAD_HALF_HEIGHT_M = 0.165
"""What is framed around each seat: a head with room for its movements."""
FRAME_FILL = 0.9
"""Part of the picture that the framed heads may fill."""
LABEL_SHARE = 0.1
"""Part of the picture's height that is kept free below each head: a name and a line under it."""
GRID_FROM = 4
"""People from whom on a grid has two rows or more."""
MAX_GRID_HEIGHT_M = 8.0
"""So many rows that no room is left for their names stand closer."""
MAX_GRID_SPACING_M = 0.42
"""Where the picture is wide enough, columns stand further apart, so that names have room."""
STRIP_COLUMN_SHARE = 0.17
"""Part of the picture's longer side for each column of those who are not pinned."""
STRIP_PER_COLUMN = 2
STRIP_PER_ROW = 3
STRIP_HEAD_SHARE = 0.26
"""Height of their heads, as part of the picture's height, at most."""
MAX_STRIP_SHARE = 0.4
"""Part of the picture that the strip takes at most: the rest is for whoever is pinned."""
MAX_FREE = 0.5

MAX_PITCH = math.radians(80)
MIN_ZOOM, MAX_ZOOM = 0.25, 12.0
ORBIT_PER_PIXEL = 0.005
"""Radians (chosen: half a turn is a drag over 630 pixels)."""
ZOOM_PER_STEP = 1.1
"""Distance ratio of one notch of the wheel."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewState:
    """What the user has done to the view. Angles in radians, about the middle of the seats."""

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


@dataclass(frozen=True, kw_only=True, slots=True)
class FreeShares:
    """Parts of the picture, 0 to `MAX_FREE`, where no head shall be."""

    top: float = 0.0
    right: float = 0.0

    def __post_init__(self) -> None:
        for name in ("top", "right"):
            share = getattr(self, name)
            if not 0 <= share <= MAX_FREE:
                raise ValueError(f"{name} is {share:g}; 0 to {MAX_FREE} can be kept free")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SeatPlan:
    """Seats, and the view that shows all of them."""

    seats: tuple[Float64Array, ...]
    """World-from-seat matrices, float64 ``[4, 4]``: +z of each seat is where its face looks, +y up.
    In the order of the people."""
    camera_m: Float64Array
    """Where the camera is as long as the user has not moved it. float64 ``[3]``."""
    target_m: Float64Array
    """What it looks at, and turns around. float64 ``[3]``."""


@dataclass(frozen=True, slots=True)
class _Frame:
    """The part of the picture for heads: tangents of angles from the optical axis, y up."""

    left: float
    right: float
    bottom: float
    top: float


def plan_seats(
    layout: Layout,
    count: int,
    aspect: float,
    *,
    pinned: int | None = None,
    free: FreeShares | None = None,
) -> SeatPlan:
    """Seats for `count` people, and the camera that shows them with their names.

    Args:
        layout: See the module.
        count: Of people; the view for none is that for one.
        aspect: Columns divided by rows of the picture.
        pinned: Index of the one who fills the picture; beyond `count` nobody is.
        free: What to keep free.

    Raises:
        ValueError: Fewer than no people, or an aspect that is not above 0.
    """
    if count < 0 or not (math.isfinite(aspect) and aspect > 0):
        raise ValueError(f"{count} people at an aspect of {aspect:g} cannot be seated")
    frame = _frame(aspect, free or FreeShares())
    if pinned is not None and 0 <= pinned < count and count > 1:
        return _plan_pinned(count, pinned, aspect, frame)
    places, pitch, faced = _ARRANGEMENTS[layout](max(count, 1), frame)
    camera_m, target_m = _framing(places, pitch, frame)
    if faced is None:
        seats = [_seat(place, camera_m) for place in places]
    else:
        seats = [_seat(place, at) for place, at in zip(places, faced, strict=True)]
    return SeatPlan(seats=tuple(seats[:count]), camera_m=camera_m, target_m=target_m)


def plan_camera(plan: SeatPlan, view: ViewState, width: int, height: int) -> Camera:
    """The viewer's camera: that of the plan, turned and moved closer as the user wants."""
    offset = plan.camera_m - plan.target_m
    distance = float(np.linalg.norm(offset))
    yaw = math.atan2(float(offset[0]), float(offset[2])) + view.yaw
    pitch = math.asin(float(offset[1]) / distance) + view.pitch
    pitch = min(max(pitch, -MAX_PITCH), MAX_PITCH)
    direction = np.array(
        [
            math.sin(yaw) * math.cos(pitch),
            math.sin(pitch),
            math.cos(yaw) * math.cos(pitch),
        ]
    )
    return look_at(
        name="viewer",
        centre_m=plan.target_m + distance / view.zoom * direction,
        target_m=plan.target_m,
        vertical_fov=VERTICAL_FOV,
        width=width,
        height=height,
    )


Arrangement = tuple[Float64Array, float, Float64Array | None]
"""Places ``[N, 3]``, the camera's pitch, and the point that each looks at ``[N, 3]``; None is the
camera."""


def _line(count: int, frame: _Frame) -> Arrangement:
    places = np.zeros((count, 3))
    places[:, 0] = _centred(count) * SEAT_SPACING_M
    return places, 0.0, places + np.array([0.0, 0.0, 1.0])


def _arc(count: int, frame: _Frame) -> Arrangement:
    angles = _centred(count) * SEAT_SPACING_M / SEAT_RADIUS_M
    places = np.stack(
        [
            SEAT_RADIUS_M * np.sin(angles),
            np.zeros(count),
            SEAT_RADIUS_M * (1 - np.cos(angles)),
        ],
        axis=-1,
    )
    return places, 0.0, np.tile([0.0, 0.0, SEAT_RADIUS_M], (count, 1))


def _table(count: int, frame: _Frame) -> Arrangement:
    """On a circle about the origin, evenly spaced as the viewer sees them; the viewer's side stays
    empty. They look at the middle of the table's near edge: half at each other, half at us."""
    across = _centred(count) * TABLE_SPACING_M
    radius = max(TABLE_RADIUS_M, 1.04 * float(across.max()))
    places = np.stack([across, np.zeros(count), -np.sqrt(radius**2 - across**2)], axis=-1)
    return places, TABLE_PITCH, np.tile([0.0, 0.0, radius], (count, 1))


def _grid(count: int, frame: _Frame) -> Arrangement:
    """A grid of as many columns as make the heads largest; the last row stands in the middle."""
    fewest_rows = 2 if count >= GRID_FROM else 1
    height_m, columns = min(
        (_grid_height_m(count, columns, frame), columns)
        for columns in range(1, math.ceil(count / fewest_rows) + 1)
    )
    rows = math.ceil(count / columns)
    pitch_m = 2 * HEAD_HALF_HEIGHT_M + LABEL_SHARE * min(height_m, MAX_GRID_HEIGHT_M)
    width_m = height_m * (frame.right - frame.left) / (2 * math.tan(VERTICAL_FOV / 2))
    room_m = (width_m - 2 * HEAD_HALF_WIDTH_M) / max(columns - 1, 1)
    spacing_m = min(max(room_m, SEAT_SPACING_M), MAX_GRID_SPACING_M)
    places = np.zeros((count, 3))
    for row in range(rows):
        first, last = row * columns, min((row + 1) * columns, count)
        places[first:last, 0] = _centred(last - first) * spacing_m
        places[first:last, 1] = ((rows - 1) / 2 - row) * pitch_m
    return places, 0.0, None


def _grid_height_m(count: int, columns: int, frame: _Frame) -> float:
    """How many metres at the grid the whole picture is high."""
    rows = math.ceil(count / columns)
    whole = 2 * math.tan(VERTICAL_FOV / 2)
    left = (frame.top - frame.bottom) / whole - (rows - 1) * LABEL_SHARE
    high = rows * 2 * HEAD_HALF_HEIGHT_M / left if left > 0 else math.inf
    span_m = (columns - 1) * SEAT_SPACING_M + 2 * HEAD_HALF_WIDTH_M
    return max(high, span_m * whole / (frame.right - frame.left))


_ARRANGEMENTS: dict[Layout, Callable[[int, _Frame], Arrangement]] = {
    "line": _line,
    "arc": _arc,
    "table": _table,
    "grid": _grid,
}


def _plan_pinned(count: int, pinned: int, aspect: float, frame: _Frame) -> SeatPlan:
    """One in front, the others in a strip at the right, or below on a picture that is higher than
    wide: as far away as makes them fit."""
    others = [index for index in range(count) if index != pinned]
    tangent = math.tan(VERTICAL_FOV / 2)
    is_wide = aspect >= 1
    lines = math.ceil(len(others) / (STRIP_PER_COLUMN if is_wide else STRIP_PER_ROW))
    longer = 2 * tangent * (aspect if is_wide else 1.0)
    floor = frame.bottom - _label(tangent)
    most = frame.right - frame.left if is_wide else frame.top - floor
    strip = min(lines * STRIP_COLUMN_SHARE * longer, MAX_STRIP_SHARE * most)
    edge = frame.right - strip if is_wide else floor + strip
    main = replace(frame, right=edge) if is_wide else replace(frame, bottom=edge + _label(tangent))
    camera_m, target_m = _framing(np.zeros((1, 3)), 0.0, main)
    seats = [_seat(np.zeros(3), camera_m)] * count
    per_line = math.ceil(len(others) / lines)
    for number, index in enumerate(others):
        line, place = divmod(number, per_line)
        in_line = min(per_line, len(others) - line * per_line)
        across, along = (line + 0.5) / lines, (place + 0.5) / in_line
        if is_wide:
            cell = (strip / lines, (frame.top - floor) / in_line)
            x = edge + across * strip
            y = frame.top - along * in_line * cell[1]
        else:
            cell = ((frame.right - frame.left) / in_line, strip / lines)
            x = frame.left + along * in_line * cell[0]
            y = edge - across * strip
        head = min(
            cell[1] - _label(tangent),
            cell[0] * 0.92 * HEAD_HALF_HEIGHT_M / HEAD_HALF_WIDTH_M,
            STRIP_HEAD_SHARE * 2 * tangent,
        )
        depth = 2 * HEAD_HALF_HEIGHT_M / max(head, 1e-3)
        # The head and its name together stand in the middle of the cell.
        at = camera_m + depth * np.array([x, y + _label(tangent) / 2, -1.0])
        seats[index] = _seat(at, camera_m)
    return SeatPlan(seats=tuple(seats), camera_m=camera_m, target_m=target_m)


def _label(tangent: float) -> float:
    """What is kept free for a name, in tangents."""
    return LABEL_SHARE * 2 * tangent


def _frame(aspect: float, free: FreeShares) -> _Frame:
    tangent = math.tan(VERTICAL_FOV / 2)
    wide = tangent * aspect
    return _Frame(
        left=-wide * FRAME_FILL,
        right=wide * (FRAME_FILL - 2 * free.right),
        bottom=tangent * (2 * LABEL_SHARE - FRAME_FILL),
        top=tangent * (FRAME_FILL - 2 * free.top),
    )


def _framing(
    places: Float64Array, pitch: float, frame: _Frame
) -> tuple[Float64Array, Float64Array]:
    """The nearest camera, looking down by `pitch`, that has all heads within `frame`, and what it
    looks at.

    A point at x, y, z in the camera's axes about the origin (right, up, towards the camera) is
    within the frame of a camera at (c, d, D) if left <= (x - c) / (D - z) <= right, which is linear
    in c and D: the smallest D follows from the extremes, and c lies between its two bounds.
    """
    sine, cosine = math.sin(pitch), math.cos(pitch)
    axes = np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
    x, y, z = np.matmul(axes, places.T)
    spans = (
        (x, HEAD_HALF_WIDTH_M, frame.left, frame.right),
        (y, HEAD_HALF_HEIGHT_M, frame.bottom, frame.top),
    )
    bounds = [
        (float((at + half + high * z).max()), float((at - half + low * z).min()), low, high)
        for at, half, low, high in spans
    ]
    distance = max(
        *((most - least) / (high - low) for most, least, low, high in bounds),
        float(z.max()) + HEAD_HALF_WIDTH_M * 2,
    )
    across, up = (
        ((most - high * distance) + (least - low * distance)) / 2
        for most, least, low, high in bounds
    )
    camera = np.array([across, up, distance]) @ axes
    middle = np.array([across, up, float(z.mean())]) @ axes
    return camera, middle


def _seat(place_m: Float64Array, towards_m: Float64Array) -> Float64Array:
    """The frame of a seat whose +z points from its place at another point, +y up."""
    forward = towards_m - place_m
    forward = forward / np.linalg.norm(forward)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    seat = np.eye(4)
    seat[:3, 0], seat[:3, 1], seat[:3, 2] = right, np.cross(forward, right), forward
    seat[:3, 3] = place_m
    return seat


def _centred(count: int) -> Float64Array:
    """-1, 0, 1 and so on: as many as wanted, about 0."""
    return np.arange(count, dtype=np.float64) - (count - 1) / 2
