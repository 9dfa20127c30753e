"""The frames of a stream in order, and the path that a face takes through them. Pure.

    insert(frame)            keep it, unless its time is over or it is there already
    restart()                only the newest stays, and counts as shown
    release(media_s)         what is captured by then counts as shown
    face_at(media_s)         where the face is then, as far as the frames tell

Between two frames the face moves evenly from one to the other. Where the next frame is too far
away, or not there, it coasts: it goes on as it last moved, ever slower, and rests after a while. It
leaves for the next frame, if that is there, just so early that it does not hurry. A still frame
says that nothing moves until one interval before the next frame.
"""

from bisect import bisect_left, bisect_right
from operator import attrgetter
from typing import Literal

from pica_client.playout.config import PlayoutConfig
from pica_client.playout.motion import blend, coasted_s
from pica_core.codec.latent_sample import DecodedFrame, LatentSample

NUM_SHOWN = 9
"""Frames kept after they were shown: 33 ms at 240 fps, for the speed of the face."""
MIN_BASE_S = 0.025
"""Shortest time that a speed is measured over: two frames 4 ms apart mostly tell the noise of the
tracker (chosen: one frame of the usual stream and less)."""

Insertion = Literal["new", "late", "duplicate", "misplaced"]
"""misplaced: captured before a frame of a lower number, or after one of a higher."""

_number = attrgetter("number")
_media_s = attrgetter("media_s")


class Timeline:
    """Frames shown and to be shown.

    Attributes:
        num_overflowed: Frames that were dropped because too many waited.
    """

    def __init__(self, config: PlayoutConfig) -> None:
        self.num_overflowed = 0
        self._max_frames = config.max_frames
        self._max_gap_s = config.max_gap_s
        self._coast_s = config.extrapolate_s
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
        if self.num_waiting > self._max_frames:
            del frames[self._num_shown]
            self.num_overflowed += 1
        return "new"

    def cut(self, media_s: float) -> int:
        """Drop waiting frames captured then or later, for a new beginning says otherwise; return
        how many there were."""
        place = max(bisect_left(self._frames, media_s, key=_media_s), self._num_shown)
        num_dropped = len(self._frames) - place
        del self._frames[place:]
        return num_dropped

    def restart(self) -> None:
        """Begin with the newest frame, which counts as shown; drop all others."""
        del self._frames[:-1]
        self._num_shown = len(self._frames)

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
        after_s = self._frames[place + 1].media_s
        return after_s - self._way_s(place, place + 1, interval_s)

    def _way_s(self, one: int, other: int, interval_s: float) -> float:
        """How long the face takes from one frame to a later one."""
        before = self._frames[one]
        longest_s = interval_s if before.sample.is_still and interval_s > 0 else self._max_gap_s
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
        is_known = 0 < gap_s <= self._max_gap_s or self._frames[base].sample.is_still
        if not is_known or way_s <= 0:
            return frame.sample
        weight = 1 + coasted_s(past_s, self._coast_s) / max(way_s, MIN_BASE_S)
        return blend(self._frames[base].sample, frame.sample, weight)
