"""A tracker says where a head is before its camera; a call shows how far it is from its seat.

The seat is where the head is when it is first seen, and it follows slowly: who pulls the chair
nearer is in the middle again a little later. What is left is limited to what a seat allows.
"""

from typing import Final

import numpy as np

from pica_core.types import Float64Array, FloatArray

FOLLOWS_S: Final = 8.0
"""How long the seat takes to come two thirds of the way."""
REACH_M: Final = np.array([0.15, 0.10, 0.15])
"""How far a head goes from its seat: sideways, up and down, to and fro."""


class Seat:
    """Where one person sits before one tracker."""

    def __init__(self) -> None:
        self._place_m: Float64Array | None = None

    def reset(self) -> None:
        """Somebody was away: the next place is the seat."""
        self._place_m = None

    def offset_m(self, place_m: FloatArray | None, step_s: float) -> FloatArray:
        """How far the head is from its seat.

        Args:
            place_m: As `TrackerSample.place_m`; None is the seat itself.
            step_s: Time since the sample before, seconds.

        Returns:
            Metres, seat axes, within `REACH_M`. float32 ``[3]``.
        """
        if place_m is None:
            return np.zeros(3, np.float32)
        place = place_m.astype(np.float64)
        if self._place_m is None:
            self._place_m = place
        self._place_m += min(step_s / FOLLOWS_S, 1.0) * (place - self._place_m)
        offset: FloatArray = np.clip(place - self._place_m, -REACH_M, REACH_M).astype(np.float32)
        return offset
