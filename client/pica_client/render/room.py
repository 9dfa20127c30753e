"""What is drawn behind the people, as far as it depends on them and on the camera. Pure.

A `Room` is drawn when it or the camera changes, and copied otherwise: so it costs next to nothing
as long as the view is not turned. Where only glows change, it is drawn around them alone.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pica_client.render.scene import NEAR_M, Rect
from pica_core.camera import Camera, look_at

TABLE_M = 0.31
"""How far the table is below the middle of the lowest head: busts have faded there."""
GLOW_M = 0.33
"""A glow ends so far from the middle of a head (background.frag)."""
ENLARGED = 0.01
"""It reaches so much farther, in shares of a picture, for the room is drawn small and enlarged."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Room:
    """Who sits where in it."""

    seats_m: tuple[tuple[float, float, float], ...] = ()
    """The middle of each head at rest, world."""
    speaking: tuple[float, ...] = ()
    """How bright the glow around each of them is, 0 to 1."""
    is_light: bool = False
    """Whether its walls are bright, as the surface's light look is."""

    @property
    def table_m(self) -> float:
        """The height of the table, below the lowest seat."""
        return min((place[1] for place in self.seats_m), default=0.0) - TABLE_M


EMPTY_ROOM = Room()
STILL = look_at(
    name="room",
    centre_m=np.array([0.0, 0.0, 1.1]),
    target_m=np.zeros(3),
    vertical_fov=0.56,
    width=16,
    height=9,
)
"""Where an empty room is seen from, whatever the camera does."""


def lens_of(camera: Camera) -> tuple[float, float, float, float]:
    """The slopes of a picture's edges against the camera's axis: left, bottom, right, top."""
    (fx, _, cx), (_, fy, cy), _ = camera.intrinsics.tolist()
    return -cx / fx, (cy - camera.height) / fy, (camera.width - cx) / fx, cy / fy


def changed_glows(before: Room, room: Room, camera: Camera) -> list[Rect] | None:
    """Left, bottom, right and top, in shares of the picture, of what looks different; None if that
    is all of it."""
    if replace(before, speaking=room.speaking) != room:
        return None
    left, bottom, right, top = lens_of(camera)
    rects = []
    for place_m, now, then in zip(room.seats_m, room.speaking, before.speaking, strict=True):
        if now == then:
            continue
        x, y, away_m = (camera.rotation @ place_m + camera.translation_m).tolist()
        if away_m - GLOW_M < NEAR_M:
            return None
        (first, last), (low, high) = _slopes(x, away_m), _slopes(-y, away_m)
        wide, tall = right - left, top - bottom
        rects.append(
            (
                (first - left) / wide - ENLARGED,
                (low - bottom) / tall - ENLARGED,
                (last - left) / wide + ENLARGED,
                (high - bottom) / tall + ENLARGED,
            )
        )
    return rects


def _slopes(aside_m: float, away_m: float) -> tuple[float, float]:
    """Between which slopes a glow lies that is so far aside of the camera's axis."""
    square = away_m**2 - GLOW_M**2
    half = GLOW_M * math.sqrt(aside_m**2 + square)
    return (aside_m * away_m - half) / square, (aside_m * away_m + half) / square
