"""Where on the picture each name may stand: pure geometry, of boxes around faces.

A name stands on the chest of its owner, no wider than the shoulders and never over a face, neither
the owner's nor another's. Who cannot be seen has no name on the picture.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pica_client.render.scene import NEAR_M, Rect, common_px, overlap
from pica_core.camera import Camera
from pica_core.types import FloatArray

FACE_LOW_M, FACE_HIGH_M = (-0.085, -0.125, 0.04), (0.085, 0.13, 0.04)
"""Opposite corners of what no name may cover: chin to hairline, ear to ear."""
HALF_WIDTH_M = 0.175
"""A name is no wider than shoulders (chosen)."""
BELOW_CHIN_M = 0.03
GAP_SHARE = 0.1
"""Part of a name's height that stays free around it."""
HIDDEN_SHARE = 0.6
"""Who is hidden by this part has no name: it would stand on the person before them."""
_POINTS = np.array(
    [
        *((x, y, FACE_LOW_M[2]) for x in (-0.085, 0.085) for y in (FACE_LOW_M[1], FACE_HIGH_M[1])),
        (0.0, FACE_LOW_M[1] - BELOW_CHIN_M, FACE_LOW_M[2]),
    ]
)
"""Corners of the face, and where its name begins."""


class _Seen(NamedTuple):
    depth_m: float
    face: Rect
    x_px: float
    """The middle of the name; at the picture's edge it has moved inwards."""
    top_px: float
    """The upper edge of the name, below the chin."""
    half_width_px: float


def place_labels(
    heads: Sequence[FloatArray], camera: Camera, least_px: tuple[float, float]
) -> list[Rect | None]:
    """The part of the picture that each person's name may fill.

    Args:
        heads: World from head, ``[4, 4]`` each.
        least_px: Columns and rows that the shortest name needs.

    Returns:
        Left, top, right and bottom in pixels, y down, in the order of the heads. None for who is
        not to be seen, or where there is no room beside the faces.
    """
    seen = [_look(head, camera, least_px) for head in heads]
    faces = [each.face for each in seen if each is not None]
    shown = [each for each in seen if each is not None and _is_seen(each, seen, camera)]
    return [
        None if each is None or each not in shown else _room(each, faces, shown, camera, least_px)
        for each in seen
    ]


def _look(head: FloatArray, camera: Camera, least_px: tuple[float, float]) -> _Seen | None:
    """Where a face is on the picture; None behind the camera."""
    pixels, depth = camera.project(_POINTS @ head[:3, :3].T + head[:3, 3])
    if depth.min() <= NEAR_M:
        return None
    (left, top), (right, bottom) = pixels[:4].min(axis=0).tolist(), pixels[:4].max(axis=0).tolist()
    chin_x, chin_y = pixels[4].tolist()
    away_m, inwards = float(depth.mean()), least_px[0] / 2 + GAP_SHARE * least_px[1]
    return _Seen(
        depth_m=away_m,
        face=(left, top, right, bottom),
        x_px=min(max(chin_x, inwards), camera.width - inwards),
        top_px=max(chin_y, bottom),
        half_width_px=HALF_WIDTH_M * float(camera.intrinsics[1, 1]) / away_m,
    )


def _room(
    own: _Seen,
    faces: Sequence[Rect],
    shown: Sequence[_Seen],
    camera: Camera,
    least_px: tuple[float, float],
) -> Rect | None:
    """What is left of the chest beside faces and other names, the middle of it the owner's."""
    gap, x, top = GAP_SHARE * least_px[1], own.x_px, own.top_px
    bottom = top + least_px[1]
    half = min(max(own.half_width_px, least_px[0] / 2), x - gap, camera.width - gap - x)
    for other in shown:  # of those beside each other each has half the way
        if other is not own and abs(other.top_px - top) < least_px[1] + gap:
            half = min(half, abs(other.x_px - x) / 2 - gap)
    for face in faces:
        if overlap((x - half, top, x + half, bottom), face):
            half = min(half, max(face[0] - gap - x, x - face[2] - gap))
    if 2 * half < least_px[0] or bottom + gap > camera.height:
        return None
    return x - half, top, x + half, bottom


def _is_seen(own: _Seen, everybody: Sequence[_Seen | None], camera: Camera) -> bool:
    """Whether enough of a face is on the picture and not behind others."""
    left, top, right, bottom = own.face
    area = (right - left) * (bottom - top)
    hidden = area - common_px(own.face, (0.0, 0.0, float(camera.width), float(camera.height)))
    nearer = [each.face for each in everybody if each and each.depth_m < own.depth_m]
    hidden = max([hidden, *(common_px(own.face, face) for face in nearer)])
    return hidden < HIDDEN_SHARE * area
