"""The frames of a stream in order, the path of a face through them, and what takes it back to its
path without a snap. Pure.

Between two frames the face moves evenly from one to the other. Where the next frame is too far
away, or not there, it coasts: it goes on as it last moved, ever slower, and rests after a while. It
leaves for the next frame, if that is there, just so early that it does not hurry. A still frame
says that nothing moves until one interval before the next frame.

Latent, rotation vector and position each move on a straight line: two frames are so close together
that the head's turn between them differs from the shortest arc by less than is seen.
"""

from bisect import bisect_left, bisect_right
from operator import attrgetter
from typing import Literal, NamedTuple

import numpy as np

from pica_core.codec.latent_stream import DecodedFrame, LatentSample
from pica_core.types import FloatArray

NUM_SHOWN = 9
"""Frames kept after they were shown: 33 ms at 240 fps, for the speed of the face."""
MAX_FRAMES = 64
"""Frames that wait; beyond it the oldest is dropped."""
MAX_GAP_S = 0.25
"""Longest time on the way between two frames; a longer gap is waited out first (chosen: 4 fps are
still moved evenly)."""
MIN_BASE_S = 0.025
"""Shortest time that a speed is measured over: two frames 4 ms apart mostly tell the noise of the
tracker (chosen: one frame of the usual stream and less)."""
UNSEEN = 1e-5
"""A difference below this, in any unit, is none."""

Insertion = Literal["new", "late", "duplicate", "misplaced"]
"""misplaced: captured before a frame of a lower number, or after one of a higher."""

_number = attrgetter("number")
_media_s = attrgetter("media_s")


def blend(before: LatentSample, after: LatentSample, weight: float) -> LatentSample:
    """Move from one face towards another; a weight above 1 goes on beyond it."""
    if weight == 0:
        return before
    if weight == 1:
        return after
    share = np.float32(weight)
    return LatentSample(
        latent=before.latent + share * (after.latent - before.latent),
        rotation=before.rotation + share * (after.rotation - before.rotation),
        translation_m=before.translation_m + share * (after.translation_m - before.translation_m),
    )


def coasted_s(past_s: float, limit_s: float) -> float:
    """How far a motion goes in some time that slows down evenly and rests after `limit_s`: the time
    in which it would have gone as far at full speed, at most half of `limit_s`."""
    if past_s >= limit_s:
        return limit_s / 2
    return past_s - past_s * past_s / (2 * limit_s)


class _Offset(NamedTuple):
    """What turns one face into another."""

    latent: FloatArray
    turn: FloatArray
    move_m: FloatArray

    def size(self) -> float:
        """The largest of its parts, in their own units."""
        return max(float(np.abs(part).max()) for part in self)


class Correction:
    """Takes what is shown back to where it should be, within `seconds`.

    What is shown is the true face plus an offset, which shrinks evenly to nothing; the true face
    moves on undamped below it.
    """

    def __init__(self, seconds: float) -> None:
        """A difference is gone in so many seconds; 0 shows it at once."""
        self._seconds = seconds
        self._left_s = 0.0
        self._offset: _Offset | None = None

    def aim(self, shown: LatentSample, true: LatentSample) -> None:
        """Begin to go from what is shown to what should have been at the same moment."""
        if self._seconds <= 0 or (shown is true and self._offset is None):
            return
        offset = _Offset(
            shown.latent - true.latent,
            shown.rotation - true.rotation,
            shown.translation_m - true.translation_m,
        )
        if self._offset is not None:
            change = _Offset(*(new - old for new, old in zip(offset, self._offset, strict=True)))
            if change.size() < UNSEEN:
                return  # nothing new: what is under way goes on
        self._offset, self._left_s = (offset if offset.size() >= UNSEEN else None), self._seconds

    def corrected(self, true: LatentSample, elapsed_s: float) -> LatentSample:
        """The face to show instead of the true one, some time after the last."""
        if self._offset is None or self._left_s <= elapsed_s:
            self._offset = None
            return true
        share = np.float32(1 - elapsed_s / self._left_s)
        self._left_s -= elapsed_s
        self._offset = _Offset(*(share * part for part in self._offset))
        return LatentSample(
            latent=true.latent + self._offset.latent,
            rotation=true.rotation + self._offset.turn,
            translation_m=true.translation_m + self._offset.move_m,
            is_still=true.is_still,
        )


class Timeline:
    """Frames shown and to be shown.

    Args:
        coast_s: Time after which a face without a next frame rests.

    """

    def __init__(self, coast_s: float) -> None:
        self._coast_s = coast_s
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

    def insert(self, frame: DecodedFrame) -> Insertion:
        """Take a frame that has just come."""
        frames = self._frames
        place = bisect_left(frames, frame.number, key=_number)
        if place < len(frames) and frames[place].number == frame.number:
            return "duplicate"
        if place < self._num_shown:
            return "late"
        if place and frames[place - 1].media_s > frame.media_s:
            return "misplaced"
        if place < len(frames) and frames[place].media_s < frame.media_s:
            return "misplaced"
        frames.insert(place, frame)
        if self.num_waiting > MAX_FRAMES:
            del frames[self._num_shown]
        return "new"

    def cut(self, media_s: float) -> None:
        """Drop waiting frames captured then or later: a new beginning says otherwise."""
        del self._frames[max(bisect_left(self._frames, media_s, key=_media_s), self._num_shown) :]

    def release(self, media_s: float) -> None:
        """Count all frames captured up to then as shown."""
        self._num_shown = max(bisect_right(self._frames, media_s, key=_media_s), self._num_shown)
        self._forget()

    def release_first(self) -> DecodedFrame:
        """Count the oldest waiting frame as shown."""
        frame = self._frames[self._num_shown]
        self._num_shown += 1
        self._forget()
        return frame

    def face_at(self, media_s: float, interval_s: float) -> LatentSample:
        """The face at a moment of the stream; a frame must have been shown."""
        place = max(bisect_right(self._frames, media_s, key=_media_s) - 1, 0)
        before = self._frames[place]
        departure_s = self._departure_s(place, interval_s)
        if media_s < departure_s:
            return self._coasted(place, media_s - before.media_s, interval_s)
        after = self._frames[place + 1]
        from_s = departure_s - before.media_s
        return blend(
            self._coasted(place, from_s, interval_s) if from_s > 0 else before.sample,
            after.sample,
            (media_s - departure_s) / (after.media_s - departure_s),
        )

    def is_under_way(self, media_s: float, interval_s: float) -> bool:
        """Whether the face is on its way to a frame that is there, rather than coasting."""
        place = max(bisect_right(self._frames, media_s, key=_media_s) - 1, 0)
        return self._departure_s(place, interval_s) <= media_s

    def _forget(self) -> None:
        num_old = max(self._num_shown - NUM_SHOWN, 0)
        del self._frames[:num_old]
        self._num_shown -= num_old

    def _departure_s(self, place: int, interval_s: float) -> float:
        """When the face leaves a frame for the next; infinite while there is none."""
        if place + 1 >= len(self._frames):
            return float("inf")
        return self._frames[place + 1].media_s - self._way_s(place, place + 1, interval_s)

    def _way_s(self, one: int, other: int, interval_s: float) -> float:
        """How long the face takes from one frame to a later one."""
        before = self._frames[one]
        longest_s = interval_s if before.sample.is_still and interval_s > 0 else MAX_GAP_S
        return min(self._frames[other].media_s - before.media_s, longest_s)

    def _coasted(self, place: int, past_s: float, interval_s: float) -> LatentSample:
        """The face some time after a frame, as if there were no next one."""
        frame = self._frames[place]
        if frame.sample.is_still or past_s <= 0 or self._coast_s <= 0 or place == 0:
            return frame.sample
        base = place - 1
        while base and frame.media_s - self._frames[base].media_s < MIN_BASE_S:
            base -= 1
        gap_s = frame.media_s - self._frames[base].media_s
        way_s = self._way_s(base, place, interval_s)
        is_known = 0 < gap_s <= MAX_GAP_S or self._frames[base].sample.is_still
        if not is_known or way_s <= 0:
            return frame.sample
        weight = 1 + coasted_s(past_s, self._coast_s) / max(way_s, MIN_BASE_S)
        return blend(self._frames[base].sample, frame.sample, weight)
