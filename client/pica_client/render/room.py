"""What is drawn behind the people, as far as it depends on them and on the camera. Pure.

A `Room` is drawn when it or the camera changes, and copied otherwise: so it costs next to nothing
as long as the view is not turned and no participant begins to speak.
"""

from dataclasses import dataclass

import numpy as np

from pica_core.camera import Camera, look_at

TABLE_M = 0.31
"""How far the table is below the middle of the lowest head: busts have faded there."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Room:
    """Who sits where in it."""

    seats_m: tuple[tuple[float, float, float], ...] = ()
    """The middle of each head at rest, world."""
    speaking: tuple[float, ...] = ()
    """How bright the glow around each of them is, 0 to 1."""

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
