"""Moving faces: from one to another, onwards into the unknown, and back without a snap. Pure.

Turns and moves are kept apart: the head turns along the shortest arc of SO(3) at constant angular
speed, and its origin, between the ears, moves on a straight line; together a geodesic of
SO(3) x R3. The other geodesic of a rigid motion, the screw, couples the two: where the origin
passes on the way then depends on where the seat's axes happen to stand, and a turn far from them
swings the head about. Trackers measure both apart, so between two measurements both go on apart; a
neck's turn of 10 degrees within a frame bows its path by half a millimetre.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pica_client.playout.rotation import blend_rotations, turn_between, turned
from pica_core.codec.latent_sample import LatentSample
from pica_core.types import FloatArray

UNSEEN = 1e-5
"""A difference below this, in any unit, is none."""


def blend(before: LatentSample, after: LatentSample, weight: float) -> LatentSample:
    """Move from one face towards another; a weight above 1 goes on beyond it."""
    if weight == 0:
        return before
    if weight == 1:
        return after
    share = np.float32(weight)
    return LatentSample(
        latent=before.latent + share * (after.latent - before.latent),
        rotation=blend_rotations(before.rotation, after.rotation, weight),
        translation_m=before.translation_m + share * (after.translation_m - before.translation_m),
    )


def coasted_s(past_s: float, limit_s: float) -> float:
    """How far a motion goes in some time that slows down evenly and rests after `limit_s`: the time
    in which it would have gone as far at full speed, at most half of `limit_s`."""
    if past_s >= limit_s:
        return limit_s / 2
    return past_s - past_s * past_s / (2 * limit_s)


class Distance(NamedTuple):
    """How far two faces are apart."""

    latent: float = 0.0
    """Root mean square over the 256 numbers of the latent."""
    turn_rad: float = 0.0
    """Angle between the two head rotations."""
    move_m: float = 0.0
    """Distance of the two head positions, metres."""


def distance(one: LatentSample, other: LatentSample) -> Distance:
    """How far two faces are apart."""
    return _Offset.between(one, other).size()


class _Offset(NamedTuple):
    """What turns one face into another, in three parts that shrink independently."""

    latent: FloatArray
    turn: FloatArray
    move_m: FloatArray

    @classmethod
    def between(cls, begin: LatentSample, end: LatentSample) -> _Offset:
        turn = turn_between(begin.rotation, end.rotation)
        return cls(end.latent - begin.latent, turn, end.translation_m - begin.translation_m)

    def size(self) -> Distance:
        flat = self.latent.ravel()
        return Distance(
            latent=math.sqrt(float(flat @ flat) / flat.size),
            turn_rad=math.hypot(*self.turn.tolist()),
            move_m=math.hypot(*self.move_m.tolist()),
        )

    def applied_to(self, face: LatentSample) -> LatentSample:
        return LatentSample(
            latent=face.latent + self.latent,
            rotation=turned(face.rotation, self.turn),
            translation_m=face.translation_m + self.move_m,
            is_still=face.is_still,
        )


class Correction:
    """Takes what is shown back to where it should be, over `seconds` and never faster than `limit`.

    What is shown is the true face plus an offset. The offset shrinks evenly to nothing within
    `seconds`, or more slowly where that would be faster than `limit`; the true face moves on
    undamped below it. So from one display time to the next the shown face moves as the true one
    does, plus at most `limit` times the time between.
    """

    def __init__(self, *, seconds: float, limit: Distance) -> None:
        """A difference is gone in so many seconds, 0 shows it at once; the limit is per second."""
        self.largest_step = 0.0
        """Largest correction of the latent at one display time so far, as in `Distance`."""
        self._seconds = seconds
        self._limit = limit
        self._left_s = 0.0
        self._offset: _Offset | None = None

    def aim(self, shown: LatentSample, true: LatentSample) -> None:
        """Begin to go from what is shown to what should have been at the same moment."""
        if self._seconds <= 0 or (shown is true and self._offset is None):
            return
        offset = _Offset.between(true, shown)
        if self._offset is not None:
            change = _Offset(*(new - old for new, old in zip(offset, self._offset, strict=True)))
            if max(change.size()) < UNSEEN:
                return  # nothing new: what is under way goes on
        if max(offset.size()) < UNSEEN:
            self._offset = None
            return
        self._offset, self._left_s = offset, self._seconds

    def end(self) -> None:
        """Show the true face at once."""
        self._offset = None

    def corrected(self, true: LatentSample, elapsed_s: float) -> LatentSample:
        """The face to show instead of the true one, some time after the last."""
        offset = self._offset
        if offset is None:
            return true
        size = offset.size()
        even = elapsed_s / self._left_s if self._left_s > elapsed_s else 1.0
        self._left_s -= elapsed_s
        shares = [
            min(even, most * elapsed_s / length) if length > 0 else 1.0
            for length, most in zip(size, self._limit, strict=True)
        ]
        self.largest_step = max(self.largest_step, shares[0] * size.latent)
        if min(shares) >= 1:
            self._offset = None
            return true
        left = [np.float32(1 - share) for share in shares]
        self._offset = _Offset(*(rest * part for rest, part in zip(left, offset, strict=True)))
        return self._offset.applied_to(true)
