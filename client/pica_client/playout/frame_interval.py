"""How often frames of a stream come, and which of them never came. Pure.

A stream is thinned on its way when a receiver or the network wants less of it, so a hole in the
sequence is no loss by itself. What tells them apart is time: after thinning the frames that are
left come at an even, longer interval; a lost frame leaves a gap among frames that come closer. The
interval is the median of the last gaps, so single losses do not move it. A hole is counted with the
longer of two intervals, when its end came and half a second or eight frames later: only then is it
known whether the stream is thinned from there on, and whether the frames were merely overtaken.
"""

from bisect import bisect_left, insort
from itertools import pairwise
from typing import NamedTuple

from pica_client.playout.sender_clock import RESTART_FRAMES
from pica_core.codec.latent_sample import DecodedFrame

NUM_GAPS = 16
"""Gaps the interval is the median of (chosen: with a third of the frames lost it still stands, and
it follows a thinned stream after eight frames)."""
COUNTED_AFTER_S = 0.5
"""Until then a frame may still come (chosen: more than twice the usual ceiling of the delay)."""
COUNTED_AFTER_FRAMES = NUM_GAPS // 2
"""The interval follows after so many."""
MAX_UNCOUNTED = 512
"""Frames whose holes are not counted yet; beyond it the oldest is."""


class _Seen(NamedTuple):
    number: int
    media_s: float
    is_still: bool
    interval_s: float


class FrameInterval:
    """Interval and losses of one stream.

    Attributes:
        interval_s: Between two frames of the layers that arrive; 0 until two have come.
        num_lost: Frames known to be lost; one that comes after it was counted stays so.
    """

    def __init__(self) -> None:
        self.interval_s = 0.0
        self.num_lost = 0
        # In order of their numbers; drop their oldest when full.
        self._recent: list[_Seen] = []
        self._uncounted: list[_Seen] = []

    def receive(self, frame: DecodedFrame) -> None:
        """Take a frame into account; one that came again changes nothing."""
        place = bisect_left(self._uncounted, (frame.number,))
        if place < len(self._uncounted) and self._uncounted[place].number == frame.number:
            return
        seen = _Seen(frame.number, frame.media_s, frame.sample.is_still, self.interval_s)
        insort(self._recent, seen)
        # What follows a still frame is a silence on purpose, and no gap.
        gaps = sorted(
            after.media_s - before.media_s
            for before, after in pairwise(self._recent)
            if not before.is_still and after.media_s > before.media_s
        )
        if gaps:
            self.interval_s = gaps[(len(gaps) - 1) // 2]
        if len(self._recent) > NUM_GAPS:
            del self._recent[0]
        if place or not self._uncounted:  # else its hole has been counted already
            self._uncounted.insert(place, seen)
        self._count_lost()

    def pause(self) -> None:
        """Note that the stream is stopped on purpose: what follows the last frame is no gap."""
        for frames in (self._recent, self._uncounted):
            if frames:
                frames[-1] = frames[-1]._replace(is_still=True)

    def num_missing(self, num_skipped: int, gap_s: float, least_interval_s: float = 0.0) -> int:
        """Return how many of the skipped frames the interval would have put into a gap."""
        interval_s = max(self.interval_s, least_interval_s)
        if interval_s <= 0 or not 0 < num_skipped < RESTART_FRAMES:
            return 0
        return min(num_skipped, max(round(gap_s / interval_s) - 1, 0))

    def _count_lost(self) -> None:
        """Count what is missing between the oldest frames, where that is known by now."""
        uncounted = self._uncounted
        while len(uncounted) > COUNTED_AFTER_FRAMES + 1:
            before, after = uncounted[:2]
            is_known = uncounted[-1].media_s - after.media_s >= COUNTED_AFTER_S
            if not is_known and len(uncounted) <= MAX_UNCOUNTED:
                return
            if not before.is_still:
                gap_s = after.media_s - before.media_s
                num_skipped = after.number - before.number - 1
                self.num_lost += self.num_missing(num_skipped, gap_s, after.interval_s)
            del uncounted[0]
