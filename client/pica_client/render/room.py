"""What is drawn behind the people, as far as it depends on them and on the camera. Pure.

A `Room` is drawn when it or the camera changes, and copied otherwise: so it costs next to nothing
as long as nobody turns the view.
"""

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from pica_core.camera import Camera, look_at
from pica_core.types import Float64Array

SITTING_M = 0.46
"""How high the middle of a head is above the floor (chosen: it is felt, not seen)."""

WIDEST_RING_M = 0.215
RING_SHARE = 0.44
"""A ring's radius against the way to the next seat, at most; the rest is its breadth."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Room:
    """Who sits where in it."""

    seats_m: tuple[tuple[float, float, float], ...] = ()
    """The middle of each head at rest, world."""
    speaking: tuple[float, ...] = ()
    """How bright the ring around each of them is, 0 to 1."""

    @property
    def ring_m(self) -> float:
        """The radius of those rings: neighbours' do not cross."""
        apart = [math.dist(one, other) for one, other in combinations(self.seats_m, 2)]
        return min(WIDEST_RING_M, RING_SHARE * min(apart, default=1.0))

    @property
    def floor_m(self) -> float:
        """The height of the floor, below the lowest seat."""
        return min((place[1] for place in self.seats_m), default=0.0) - SITTING_M


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


def world_from_view(camera: Camera) -> Float64Array:
    """Right, up and forward of a camera as columns. float64 ``[3, 3]``."""
    axes: Float64Array = camera.rotation.T * np.array([1.0, -1.0, 1.0])
    return axes
