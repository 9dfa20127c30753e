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
        *((x, FACE_LOW_M[1], FACE_LOW_M[2]) for x in (FACE_LOW_M[0], FACE_HIGH_M[0])),
        *((x, FACE_HIGH_M[1], FACE_LOW_M[2]) for x in (FACE_LOW_M[0], FACE_HIGH_M[0])),
        (0.0, FACE_LOW_M[1] - BELOW_CHIN_M, FACE_LOW_M[2]),
    ]
)
"""Corners of the face, and where its name begins."""


class _Seen(NamedTuple):
    face: Rect
    x_px: float
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
    depths = [float((camera.rotation @ head[:3, 3] + camera.translation_m)[2]) for head in heads]
    seen = _look(heads, camera)
    rooms: list[Rect | None] = [None] * len(heads)
    taken: list[Rect] = []
    faces: list[Rect] = []
    for index in sorted(range(len(heads)), key=depths.__getitem__):
        own = seen[index]
        if own is None or not _is_seen(own.face, faces, camera):
            continue
        faces.append(own.face)
        others = [each.face for number, each in enumerate(seen) if each and number != index]
        room = _room(own, others, taken, camera, least_px)
        if room is not None:
            taken.append((room[0], room[1], room[2], room[1] + least_px[1]))
            rooms[index] = room
    return rooms


def _look(heads: Sequence[FloatArray], camera: Camera) -> list[_Seen | None]:
    """Where faces are on the picture; None behind the camera."""
    if not heads:
        return []
    turned = np.stack(heads)
    points = _POINTS @ turned[:, :3, :3].transpose(0, 2, 1) + turned[:, None, :3, 3]
    pixels, depth = camera.project(points.reshape(-1, 3))
    focal_px = float(camera.intrinsics[1, 1])
    found: list[_Seen | None] = []
    # Five points each: Python's own numbers are faster than numpy's here.
    for each, away in zip(
        pixels.reshape(-1, 5, 2).tolist(), depth.reshape(-1, 5).tolist(), strict=True
    ):
        columns, rows = zip(*each[:4], strict=True)
        chin_x, chin_y = each[4]
        seen = _Seen(
            face=(min(columns), min(rows), max(columns), max(rows)),
            x_px=chin_x,
            top_px=max(chin_y, *rows),
            half_width_px=HALF_WIDTH_M * focal_px * len(away) / sum(away),
        )
        found.append(seen if min(away) > NEAR_M else None)
    return found


def _is_seen(face: Rect, nearer: Sequence[Rect], camera: Camera) -> bool:
    """Whether enough of a face is on the picture and not behind others."""
    area = (face[2] - face[0]) * (face[3] - face[1])
    hidden = area - common_px(face, (0.0, 0.0, float(camera.width), float(camera.height)))
    hidden = max([hidden, *(common_px(face, other) for other in nearer)])
    return hidden < HIDDEN_SHARE * area


def _room(
    own: _Seen,
    faces: Sequence[Rect],
    names: Sequence[Rect],
    camera: Camera,
    least_px: tuple[float, float],
) -> Rect | None:
    """What is left of the chest beside faces and other names, the middle of it the owner's."""
    gap, obstacles = GAP_SHARE * least_px[1], [*faces, *names]
    half = own.half_width_px
    for left, top, right, bottom in faces:
        if top < own.face[3] and own.face[1] < bottom:  # a neighbour: each has half the way
            half = min(half, abs((left + right) / 2 - own.x_px) / 2 - gap)
    half = min(max(half, least_px[0] / 2), camera.width / 2 - gap)
    # At the picture's edge a name moves inwards, as far as its owner is wide.
    x = min(max(own.x_px, half + gap), camera.width - half - gap)
    if not own.face[0] <= x <= own.face[2]:
        x = min(max(own.x_px, least_px[0] / 2 + gap), camera.width - least_px[0] / 2 - gap)
        half = min(half, x - gap, camera.width - gap - x)
    top, bottom = own.top_px, camera.height - gap
    for other in obstacles:
        if not overlap((x - half, top, x + half, top + least_px[1]), other):
            continue
        half = min(half, max(other[0] - gap - x, x - other[2] - gap))
    for other in obstacles:
        if overlap((x - half, top, x + half, bottom), other):
            bottom = min(bottom, other[1] - gap)
    if 2 * half < least_px[0] or bottom - top < least_px[1]:
        return None
    return x - half, top, x + half, bottom
