"""Heads on their seats, and where on the picture they are: pure geometry, no GPU.

World: metres, +y up; `seats` says who sits where.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pica_client.render.seats import HEAD_HALF_HEIGHT_M, HEAD_HALF_WIDTH_M
from pica_core.camera import Camera
from pica_core.types import Float64Array, FloatArray

Rect = tuple[float, float, float, float]
"""Left, top, right and bottom in image pixels, y down, unless said otherwise."""
NEAR_M = 0.02
FAR_M = 20.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Placement:
    """One head of a drawn frame."""

    slot: str
    """Which avatar of the renderer."""
    world_from_head: FloatArray
    """Head frame to world, float32 ``[4, 4]`` for column vectors."""
    fade: float = 0.0
    """0 is as it is, 1 has faded into the room: for stale faces."""
    scale: float = 1.0
    """Share of the image's resolution that it is drawn with, to be enlarged."""


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


def screen_rects(matrices: FloatArray, outlines_m: FloatArray) -> list[Rect | None]:
    """Left, bottom, right, top of what convex bodies cover in clip space, within [-1, 1]; None of
    one of which nothing is on the screen. One that reaches behind the near plane may cover
    everything.

    Args:
        matrices: To clip space, ``[N, 4, 4]`` for column vectors.
        outlines_m: Points that hold each between them, ``[N, K, 3]``.
    """
    clip = np.matmul(outlines_m, matrices[:, :, :3].transpose(0, 2, 1).astype(np.float64))
    clip += matrices[:, None, :, 3]
    w = clip[..., 3]
    is_behind = w <= NEAR_M
    nearest, farthest = is_behind.any(axis=1), is_behind.all(axis=1)
    places = clip[..., :2] / np.where(is_behind, 1.0, w)[..., None]
    low, high = np.clip(places.min(axis=1), -1, 1), np.clip(places.max(axis=1), -1, 1)
    is_seen = np.isfinite(clip).all(axis=(1, 2)) & ~farthest
    is_seen &= nearest | (low < high).all(axis=1)
    low[nearest], high[nearest] = -1, 1
    rects: list[Rect | None] = []
    for seen, (left, bottom), (right, top) in zip(
        is_seen.tolist(), low.tolist(), high.tolist(), strict=True
    ):
        rects.append((left, bottom, right, top) if seen else None)
    return rects


def head_rect_px(camera: Camera, world_from_head: npt.ArrayLike) -> Rect | None:
    """The part of the picture that a head and its movements may cover, by the matrix ``[4, 4]`` of
    the head or of its seat; None if it is not before the camera."""
    centre = np.asarray(world_from_head, np.float64)[:3, 3]
    right, down = camera.rotation[0], camera.rotation[1]
    reach = np.outer([-1, 1], HEAD_HALF_WIDTH_M * right + HEAD_HALF_HEIGHT_M * down)
    pixels, depth = camera.project(centre + reach)
    if (depth <= NEAR_M).any():
        return None
    (left, top), (right_px, bottom) = pixels.tolist()
    return left, top, right_px, bottom


def common_px(first: Rect, second: Rect) -> float:
    """The area that two rectangles share."""
    width = min(first[2], second[2]) - max(first[0], second[0])
    height = min(first[3], second[3]) - max(first[1], second[1])
    return max(width, 0.0) * max(height, 0.0)


def pick_head(
    placements: Sequence[Placement], camera: Camera, x_px: float, y_px: float
) -> str | None:
    """The slot of the nearest head at a place of the picture; None where there is none."""
    found: list[tuple[float, str]] = []
    for placement in placements:
        rect = head_rect_px(camera, placement.world_from_head)
        if rect is not None and rect[0] <= x_px <= rect[2] and rect[1] <= y_px <= rect[3]:
            away = placement.world_from_head[:3, 3].astype(np.float64) - camera.centre_m
            found.append((float(np.linalg.norm(away)), placement.slot))
    return min(found)[1] if found else None
