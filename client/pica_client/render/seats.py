"""Who sits where, and from where all are seen: pure geometry. `views` has the camera.

World: metres, +y up; the viewer is on the +z side and looks towards -z. Three layouts:

    line    side by side on an arc around the viewer, everybody facing the viewer
    table   around the far side of a round table, seen from a little above
    grid    rows and columns, everybody facing the viewer

Neighbours sit as far apart as the broadest shoulders need; where a row would be small for that,
every second one moves back a little and they close up. Where a grid shows larger faces than the row
all the same, as on a narrow picture, the grid is taken.

In each of them one participant may be pinned: that one stands large, and the others look on from a
strip at the side.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from pica_core.errors import check_ranges
from pica_core.types import Float64Array

Layout = Literal["line", "table", "grid"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)

SHOULDERS_M = 0.36
"""Width of the shoulders of a person without an avatar yet."""
MIN_SHOULDERS_M, MAX_SHOULDERS_M = 0.22, 0.56
"""A head alone keeps room for its movements, and no file from a stranger pushes everybody aside."""
SHOULDER_GAP_M = 0.025
"""Between the shoulders of neighbours: heads move (chosen)."""
SHOULDER_DEPTH_M = 0.07
"""Seats that are turned to each other come closer at the front of the shoulders, which reach so far
before the middle of the head."""
GRID_INSTEAD = 1.12
"""A row gives way to the grid where that makes the heads so many times larger (chosen: five people
sit in a row on a picture of 16:9, and in a grid on one of 4:3)."""
TABLE_RADIUS_M, TABLE_ARC = 0.62, 2.7
"""The table's, and how many radians of it people sit around at most: the rest is the viewer's."""
TABLE_PITCH = math.radians(9)
"""How far from above the table is seen (chosen: a person who sits at it)."""
VERTICAL_FOV = math.radians(32)
"""The viewer's field of view (chosen: little perspective distortion at the outer seats)."""
HEAD_HALF_WIDTH_M = 0.115
HEAD_HALF_HEIGHT_M = 0.165
"""What is framed around each seat: a head with room for its movements."""
HALF_WIDTH_M, BUST_M = 0.15, 0.3
"""How far aside of the middle of its head a bust is framed, and below: it has faded there."""
FRAME_FILL, FRAME_FILL_ACROSS = 0.9, 0.96
"""Part of the picture's height and width that the framed heads may fill."""
ROW_FILL = 0.7
"""Part of the picture's height that busts in a row may fill: heads are three eighths of it then
(chosen: as people are filmed who talk)."""
EYES_SHARE = 0.36
"""Where the eyes of a row are best, from the top of what it may fill (chosen: the upper third)."""
CLOSE_SHARE = 0.72
"""People move so much closer than their shoulders are wide, every second one behind the others,
where that makes their heads larger."""
LABEL_SHARE = 0.075
"""Part of the picture's height that is kept free below each head: a name and a line under it."""
GRID_FROM = 4
"""People from whom on a grid has two rows or more."""
STRIP_BESIDE = 1.25
"""Pictures at least so wide for their height have the strip of those who are not pinned at the
right; others have it below."""
STRIP_LINE_SHARE = 0.17
"""Part of what is free of the picture for each column or row of it."""
STRIP_PER_LINE = 4
STRIP_HEAD_SHARE = 0.26
"""Height of their heads, as part of the picture's height, at most."""
MAX_STRIP_SHARE = 0.4
"""Part of the picture that the strip takes at most: the rest is for the pinned person."""
PINNED_CHEST_M = 0.36
"""How far below the middle of a pinned head nothing of the strip may begin."""
MAX_FREE = 0.5
SETTLED_M = 0.002
"""A head nearer than this to its seat has arrived: no difference is seen."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FreeShares:
    """Parts of the picture, 0 to `MAX_FREE`, where no head shall be."""

    top: float = 0.0
    right: float = 0.0
    bottom: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self, top=(0, MAX_FREE), right=(0, MAX_FREE), bottom=(0, MAX_FREE))


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

    def nearing(self, goal: SeatPlan, share: float) -> SeatPlan:
        """This plan, moved by a share of the way to another one for the same people; that one,
        where no difference would be seen."""
        start, end = (
            np.array([plan.camera_m, plan.target_m, *plan.places_m]) for plan in (self, goal)
        )
        if np.abs(end - start).max() < SETTLED_M:
            return goal
        camera_m, target_m, *places = start + share * (end - start)
        turns = zip(places, self.seats, goal.seats, strict=True)
        return SeatPlan(
            seats=tuple(
                _seat(place, place + seat[:3, 2] + share * (to[:3, 2] - seat[:3, 2]))
                for place, seat, to in turns
            ),
            camera_m=camera_m,
            target_m=target_m,
        )

    @property
    def places_m(self) -> tuple[tuple[float, float, float], ...]:
        """The middle of each head at rest, world."""
        return tuple((float(x), float(y), float(z)) for x, y, z in (s[:3, 3] for s in self.seats))


@dataclass(frozen=True, slots=True)
class _Frame:
    """The part of the picture for heads: tangents of angles from the optical axis, y up."""

    left: float
    right: float
    bottom: float
    top: float


@lru_cache(maxsize=8)
def plan_seats(
    layout: Layout,
    count: int,
    aspect: float,
    *,
    pinned: int | None = None,
    free: FreeShares | None = None,
    shoulders_m: float = SHOULDERS_M,
) -> SeatPlan:
    """Seats for `count` people, and the camera that shows them with their names.

    Args:
        count: Of people; the view for none is that for one.
        aspect: Columns divided by rows of the picture.
        pinned: Index of the one who fills the picture; beyond `count` no one does.
        shoulders_m: Width of the broadest shoulders, within `MIN_SHOULDERS_M` to
            `MAX_SHOULDERS_M`.

    Raises:
        ValueError: Fewer than no people, or an aspect that is not above 0.
    """
    if count < 0 or not (math.isfinite(aspect) and aspect > 0):
        raise ValueError(f"{count} people at an aspect of {aspect:g} cannot be seated")
    frame = _frame(aspect, free or FreeShares())
    shoulders_m = min(max(shoulders_m, MIN_SHOULDERS_M), MAX_SHOULDERS_M)
    if pinned is not None and 0 <= pinned < count and count > 1:
        return _plan_pinned(layout, count, pinned, aspect, frame, shoulders_m)
    spacing_m = shoulders_m + SHOULDER_GAP_M
    places, pitch, faced = _grid(max(count, 1), frame, spacing_m)
    camera_m, target_m = _framing(places, pitch, frame, half_width=HALF_WIDTH_M)
    if layout != "grid":
        # Busts in a row need no room below for their names.
        tangent = math.tan(VERTICAL_FOV / 2)
        low, high = frame.bottom - 2 * tangent * LABEL_SHARE, frame.top
        fill = tangent * ROW_FILL
        inner = replace(frame, bottom=max(low, -fill), top=min(high, fill))
        eyes = high - (high - low) * EYES_SHARE
        row = _ARRANGEMENTS[layout](max(count, 1), inner, spacing_m)
        framed = _framing(*row[:2], inner, half_width=HALF_WIDTH_M, below_m=BUST_M, eyes=eyes)
        has_rows = bool(np.ptp(places[:, 1]) > 0)
        if not has_rows or _distance(*framed) <= GRID_INSTEAD * _distance(camera_m, target_m):
            (places, pitch, faced), (camera_m, target_m) = row, framed
    towards = [camera_m] * len(places) if faced is None else faced
    seats = [_seat(place, at) for place, at in zip(places, towards, strict=True)]
    return SeatPlan(seats=tuple(seats[:count]), camera_m=camera_m, target_m=target_m)


Arrangement = tuple[Float64Array, float, Float64Array | None]
"""Places ``[N, 3]``, the camera's pitch, and the point that each looks at ``[N, 3]``; None is the
camera."""


def _line(count: int, frame: _Frame, spacing_m: float) -> Arrangement:
    """On an arc about the viewer, who sees everybody's face from the front and of one size."""
    across, behind = _closed_up(count, frame, spacing_m)
    radius = max(
        (BUST_M + HEAD_HALF_HEIGHT_M) / (frame.top - frame.bottom),
        (float(across.max()) + HALF_WIDTH_M) / math.atan((frame.right - frame.left) / 2),
    )
    angles, away = across / (radius - SHOULDER_DEPTH_M), radius + behind
    places = np.stack(
        [away * np.sin(angles), np.zeros(count), radius - away * np.cos(angles)], axis=-1
    )
    return places, 0.0, None


def _closed_up(count: int, frame: _Frame, spacing_m: float) -> tuple[Float64Array, Float64Array]:
    """Where people in a row are from left to right, and how far behind the first ones: as close as
    makes their heads as large as `ROW_FILL` wants, down to `CLOSE_SHARE`."""
    shape = (frame.right - frame.left) / (frame.top - frame.bottom)
    room_m = (shape * (BUST_M + HEAD_HALF_HEIGHT_M) - 2 * HALF_WIDTH_M) / max(count - 1, 1)
    closer = min(max(room_m / spacing_m, CLOSE_SHARE), 1.0)
    # Shoulders are ellipses, seen from above: so far behind, they just pass each other.
    behind_m = 2.2 * SHOULDER_DEPTH_M * math.sqrt(1 - closer**2)
    return _centred(count) * closer * spacing_m, np.where(np.arange(count) % 2, behind_m, 0.0)


def _table(count: int, frame: _Frame, spacing_m: float) -> Arrangement:
    """On a circle about the origin; the viewer's side stays empty. They look at the middle of the
    table's near edge: half at each other, half at us."""
    radius = max(TABLE_RADIUS_M, (count - 1) * spacing_m / TABLE_ARC)
    angles = _centred(count) * spacing_m / radius
    places = radius * np.stack([np.sin(angles), np.zeros(count), -np.cos(angles)], axis=-1)
    return places, TABLE_PITCH, np.tile([0.0, 0.0, radius], (count, 1))


def _grid(count: int, frame: _Frame, spacing_m: float) -> Arrangement:
    """A grid of as many columns as make the heads largest; the last row stands in the middle."""

    def distance_m(columns: int) -> float:
        """How far away a grid is wholly in the picture."""
        rows = math.ceil(count / columns)
        high_m = (rows - 1) * (BUST_M + HEAD_HALF_HEIGHT_M) + 2 * HEAD_HALF_HEIGHT_M
        wide_m = (columns - 1) * spacing_m + 2 * HALF_WIDTH_M
        return max(high_m / (frame.top - frame.bottom), wide_m / (frame.right - frame.left))

    fewest_rows = 2 if count >= GRID_FROM else 1
    columns = min(range(1, math.ceil(count / fewest_rows) + 1), key=distance_m)
    rows = math.ceil(count / columns)
    places = np.zeros((count, 3))
    for row in range(rows):
        first, last = row * columns, min((row + 1) * columns, count)
        places[first:last, 0] = _centred(last - first) * spacing_m
        places[first:last, 1] = ((rows - 1) / 2 - row) * (BUST_M + HEAD_HALF_HEIGHT_M)
    return places, 0.0, None


_ARRANGEMENTS: dict[Layout, Callable[[int, _Frame, float], Arrangement]] = {
    "line": _line,
    "table": _table,
}


def _plan_pinned(
    layout: Layout, count: int, pinned: int, aspect: float, frame: _Frame, shoulders_m: float
) -> SeatPlan:
    """One in front, the others in a strip at the right or below: as far away as makes them fit."""
    others = [index for index in range(count) if index != pinned]
    tangent, is_wide = math.tan(VERTICAL_FOV / 2), aspect >= STRIP_BESIDE
    lines = math.ceil(len(others) / STRIP_PER_LINE)
    per_line = math.ceil(len(others) / lines)
    share = min(lines * STRIP_LINE_SHARE, MAX_STRIP_SHARE)
    floor = frame.bottom - 2 * tangent * LABEL_SHARE
    left, top = frame.left, frame.top
    if is_wide:
        left = frame.right - share * (frame.right - left)
        own, below_m, columns, rows = (
            replace(frame, right=left),
            HEAD_HALF_HEIGHT_M,
            lines,
            per_line,
        )
    else:
        top = floor + share * (top - floor)
        own, below_m, columns, rows = replace(frame, bottom=top), PINNED_CHEST_M, per_line, lines
    half_width = shoulders_m / 2
    camera_m, target_m = _framing(
        np.zeros((1, 3)), 0.0, own, half_width=half_width, below_m=below_m
    )
    width, height = (frame.right - left) / columns, (top - floor) / rows
    bust_per_head = (BUST_M + HEAD_HALF_HEIGHT_M) / (2 * HEAD_HALF_HEIGHT_M)
    head_per_width = 2 * HEAD_HALF_HEIGHT_M / (shoulders_m + SHOULDER_GAP_M)
    head = min(height / bust_per_head, width * head_per_width, STRIP_HEAD_SHARE * 2 * tangent)
    seats = [_seat(np.zeros(3), camera_m)] * count
    for number, index in enumerate(others):
        column, row = divmod(number, rows) if is_wide else divmod(number, columns)[::-1]
        # The bust stands in the middle of the cell.
        y = top - (row + 0.5) * height + head * (bust_per_head - 1) / 2
        at = np.array([left + (column + 0.5) * width, y, -1.0]) * 2 * HEAD_HALF_HEIGHT_M / head
        seats[index] = _seat(camera_m + at, camera_m)
    return SeatPlan(seats=tuple(seats), camera_m=camera_m, target_m=target_m)


def _frame(aspect: float, free: FreeShares) -> _Frame:
    tangent = math.tan(VERTICAL_FOV / 2)
    wide = tangent * aspect
    return _Frame(
        left=-wide * FRAME_FILL_ACROSS,
        right=wide * (FRAME_FILL_ACROSS - 2 * free.right),
        bottom=tangent * (2 * LABEL_SHARE - FRAME_FILL + 2 * free.bottom),
        top=tangent * (FRAME_FILL - 2 * free.top),
    )


def _framing(
    places: Float64Array,
    pitch: float,
    frame: _Frame,
    *,
    half_width: float = HEAD_HALF_WIDTH_M,
    below_m: float = HEAD_HALF_HEIGHT_M,
    eyes: float | None = None,
) -> tuple[Float64Array, Float64Array]:
    """The nearest camera, looking down by `pitch`, that has all heads within `frame`, and what it
    looks at; with the eyes as near to a height of the picture as may be, else all in its middle.

    A point at x, y, z in the camera's axes about the origin (right, up, towards the camera) is
    within the frame of a camera at (c, d, D) if left <= (x - c) / (D - z) <= right, which is linear
    in c and D: the smallest D follows from the extremes, and c lies between its two bounds.
    """
    sine, cosine = math.sin(pitch), math.cos(pitch)
    axes = np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
    x, y, z = np.matmul(axes, places.T)
    spans = (
        (x, half_width, half_width, frame.left, frame.right),
        (y, below_m, HEAD_HALF_HEIGHT_M, frame.bottom, frame.top),
    )
    bounds = [
        (float((at + after + high * z).max()), float((at - before + low * z).min()), low, high)
        for at, before, after, low, high in spans
    ]
    distance = max(
        *((most - least) / (high - low) for most, least, low, high in bounds),
        float(z.max()) + HEAD_HALF_WIDTH_M * 2,
    )
    (left, right), (low, high) = (
        (most - high * distance, least - low * distance) for most, least, low, high in bounds
    )
    across, up = (left + right) / 2, (low + high) / 2
    if eyes is not None:
        up = min(max(float(y.mean()) - eyes * distance, low), high)
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


def _distance(camera_m: Float64Array, target_m: Float64Array) -> float:
    """How far a camera is from what it looks at, metres."""
    return float(np.linalg.norm(camera_m - target_m))
