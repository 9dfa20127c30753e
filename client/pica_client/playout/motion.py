"""Which moment of a stream the display is at, the frames of the stream in order, the path of a face
through them, and what takes it back to its path without a snap. Pure.

The moment that should be shown moves when the playout delay changes. Following it at once would be
seen: so the display's time runs a little faster or slower until it is there, and never backwards.
Only where that would take too long it leaps forwards.

Between two frames the face moves evenly from one to the other. Where the next frame is too far
away, or not there, it rests. It leaves for the next frame, if that is there, just so early that it
does not hurry. A still frame says that nothing moves until one interval before the next frame.

Latent, rotation vector and position each move on a straight line: two frames are so close together
that the head's turn between them differs from the shortest arc by less than is seen.
"""

import math
from bisect import bisect_right
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from pica_client.playout.sender_clock import DecodedFrame
from pica_core.codec.latent_stream import LatentSample
from pica_core.types import LATENT_SHAPE, NUM_LATENT, FloatArray

NUM_SHOWN = 9
"""Frames kept after they were shown: 33 ms at 240 fps, for where the face was an image ago."""
MAX_FRAMES = 64
"""Frames that wait; beyond it the oldest is dropped."""
MAX_GAP_S = 0.25
"""Longest time on the way between two frames; a longer gap is waited out first (chosen: 4 fps are
still moved evenly)."""
BLEND_S = 0.15
"""Time in which the face goes over to its path after it had to leave it (chosen: a blink)."""
UNSEEN = 1e-5
"""A difference below this, in any unit, is none."""

LEAP_S = 0.25
"""A display this far behind leaps, and the face goes over as after a gap."""
FASTER, SLOWER = 0.1, 0.25
"""Shares by which display time runs faster to catch up (chosen: speech 10 % faster looks natural)
and slower to fall back: more, for frames are late meanwhile."""
LED_RATE = 1.0
"""The same where a voice leads: it has been stretched already, and says how fast time goes."""
LED_LEAP_S = 0.04
"""A display this far behind the voice that leads it leaps: lips may be 45 ms late (ITU-R
BT.1359)."""
SMOOTHING = 0.1
"""Weight of a new display interval in the mean."""
MAX_STEP_S = 0.25
"""A longer step is a pause of the display."""

_media_s = attrgetter("media_s")


def blend(before: LatentSample, after: LatentSample, weight: float) -> LatentSample:
    """Move from one face towards another; a weight above 1 goes on beyond it."""
    if weight == 0:
        return before
    if weight == 1:
        return after
    one = _flat(before)
    return _face(one + np.float32(weight) * (_flat(after) - one))


def _flat(face: LatentSample) -> FloatArray:
    """Latent, rotation and translation one after the other, float32 ``[262]``."""
    return np.concatenate((face.latent.ravel(), face.rotation, face.translation_m))


def _face(flat: FloatArray, *, is_still: bool = False) -> LatentSample:
    latent = flat[:NUM_LATENT].reshape(LATENT_SHAPE)
    rotation, translation_m = flat[NUM_LATENT:].reshape(2, 3)
    return LatentSample(
        latent=latent, rotation=rotation, translation_m=translation_m, is_still=is_still
    )


class Correction:
    """Takes what is shown back to where it should be, within `BLEND_S`.

    What is shown is the true face plus an offset, which shrinks evenly to nothing; the true face
    moves on undamped below it.
    """

    def __init__(self) -> None:
        self._left_s = 0.0
        self._offset: FloatArray | None = None

    def aim(self, shown: LatentSample, true: LatentSample) -> None:
        """Begin to go from what is shown to what should have been at the same moment."""
        if shown is true and self._offset is None:
            return
        offset = _flat(shown) - _flat(true)
        if self._offset is not None and np.abs(offset - self._offset).max() < UNSEEN:
            return  # nothing new: what is under way goes on
        self._offset = offset if np.abs(offset).max() >= UNSEEN else None
        self._left_s = BLEND_S

    def corrected(self, true: LatentSample, elapsed_s: float) -> LatentSample:
        """The face to show instead of the true one, some time after the last."""
        if self._offset is None or self._left_s <= elapsed_s:
            self._offset = None
            return true
        self._offset = np.float32(1 - elapsed_s / self._left_s) * self._offset
        self._left_s -= elapsed_s
        return _face(_flat(true) + self._offset, is_still=true.is_still)


class Timeline:
    """Frames shown and to be shown."""

    def __init__(self) -> None:
        self._frames: list[DecodedFrame] = []  # shown ones first; both bounded
        self._num_shown = 0

    @property
    def num_waiting(self) -> int:
        """Frames that are not shown yet."""
        return len(self._frames) - self._num_shown

    @property
    def held(self) -> DecodedFrame | None:
        """The newest frame that counts as shown."""
        return self._frames[self._num_shown - 1] if self._num_shown else None

    @property
    def following(self) -> DecodedFrame | None:
        """The oldest frame that does not."""
        return self._frames[self._num_shown] if self.num_waiting else None

    @property
    def newest_s(self) -> float:
        """When the newest frame was captured; there must be one."""
        return self._frames[-1].media_s

    def append(self, frame: DecodedFrame) -> bool:
        """Take a frame that has just come, instead of those that wait and were captured later: they
        are of another beginning. Return False if one was shown that was captured later."""
        place = bisect_right(self._frames, frame.media_s, key=_media_s)
        if place < self._num_shown:
            return False
        self._frames[place:] = [frame]
        if self.num_waiting > MAX_FRAMES:
            del self._frames[self._num_shown]
        return True

    def release(self, media_s: float) -> None:
        """Count all frames captured up to then as shown."""
        self._num_shown = max(bisect_right(self._frames, media_s, key=_media_s), self._num_shown)
        num_old = max(self._num_shown - NUM_SHOWN, 0)
        del self._frames[:num_old]
        self._num_shown -= num_old

    def face_at(self, media_s: float, interval_s: float) -> LatentSample:
        """The face at a moment of the stream; a frame must have been shown."""
        place = max(bisect_right(self._frames, media_s, key=_media_s) - 1, 0)
        before = self._frames[place]
        departure_s = self._departure_s(place, interval_s)
        if media_s < departure_s:
            return before.sample
        after = self._frames[place + 1]
        share = (media_s - departure_s) / (after.media_s - departure_s)
        return blend(before.sample, after.sample, share)

    def is_under_way(self, media_s: float, interval_s: float) -> bool:
        """Whether the face is on its way to a frame that is there, rather than at rest."""
        place = max(bisect_right(self._frames, media_s, key=_media_s) - 1, 0)
        return self._departure_s(place, interval_s) <= media_s

    def _departure_s(self, place: int, interval_s: float) -> float:
        """When the face leaves a frame for the next; infinite while there is none."""
        if place + 1 >= len(self._frames):
            return math.inf
        before, after = self._frames[place : place + 2]
        longest_s = interval_s if before.sample.is_still and interval_s > 0 else MAX_GAP_S
        return max(before.media_s, after.media_s - longest_s)


class Step(NamedTuple):
    """The step from one display time to the next."""

    elapsed_s: float
    """Time that passed on our clock."""
    moved_s: float
    """How far the moment shown went on; where it leapt, how far it would have gone."""
    is_leap: bool = False


class Playhead:
    """The display's time of one stream.

    Attributes:
        position_s: The moment shown, on the stream's time line; minus infinity before the first.
        step_s: Mean time between two display times.
    """

    def __init__(self) -> None:
        self.position_s = -math.inf
        self.step_s = 0.0
        self._now = -math.inf

    def advance(self, now: float, target_s: float, end_s: float, *, is_led: bool = False) -> Step:
        """Go on to a display time.

        Args:
            now: Our clock.
            target_s: The moment that should be shown.
            end_s: The moment up to which the face last shown had moved: where the display stands
                still beyond it, falling back that far is not seen.
            is_led: Whether the target is what a voice says just now, rather than what is waited.
        """
        if self.position_s == -math.inf:
            self.position_s, self._now = target_s, now
            return Step(0.0, 0.0)
        elapsed_s = max(now - self._now, 0.0)
        self._now = max(now, self._now)
        if elapsed_s <= MAX_STEP_S:
            self.step_s += SMOOTHING * (elapsed_s - self.step_s)
        before_s = self.position_s
        behind_s = target_s - before_s - elapsed_s
        faster, slower = (LED_RATE, LED_RATE) if is_led else (FASTER, SLOWER)
        if behind_s > (LED_LEAP_S if is_led else LEAP_S):
            self.position_s = target_s
            return Step(elapsed_s, elapsed_s, is_leap=True)
        rate = min(max(behind_s, -slower * elapsed_s), faster * elapsed_s)
        position_s = before_s + elapsed_s + rate
        if end_s < position_s and target_s < position_s:
            position_s = max(target_s, min(end_s, position_s))
        self.position_s = position_s
        return Step(elapsed_s, max(position_s - before_s, 0.0))
