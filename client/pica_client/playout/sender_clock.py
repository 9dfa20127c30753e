"""From what a frame says of itself to its place on one even time line, and what the arrivals of a
stream tell: how long frames take, how late some are, how often they come. Pure.

On a websocket nothing is lost and nothing overtakes: a hole was left for newer frames, on purpose
or by a sender or relay that could not keep up, and what comes again, or late, is of no use.

A frame names a sequence, which wraps and may begin again, and a capture time on the sender's clock,
which may jump. Here it gets a `number` that never wraps and a `media_s` that goes on as our own
clock does, whatever the sender's does.

A frame that contradicts the newest one is the first of a new beginning:

    what is wrong                                         what has happened
    captured before the newest, of a later sequence       the clock was set back
    captured after the newest, of an earlier sequence     the sender began again
    the sequence of the newest, another capture time      the sender began again
    a sequence far ahead of the newest or far behind it   the sender began again
    an earlier sequence, `LATE_S` later than it should    both at once

The time line goes on from there as if the frame had come the fastest way. A frame that is wrong by
itself makes two beginnings, its own and that of the next one: it is seen for a moment in the stream
of the sender who sent it. The numbers leap by more than `RESTART_FRAMES`.
A clock that is set forward needs no rule: its frames are the fastest from then on, and those before
are too late to be waited for.

The transit of a frame is its arrival on our clock minus its capture on the sender's: network delay
plus an unknown offset between two clocks. The network only ever adds, so the lowest transit of the
last seconds is that of the fastest way. The window forgets, so a clock that drifts, a longer route
and a standing queue are followed without being measured: 200 parts in a million are 1 ms in it.

How far a transit lies above the fastest is the frame's lateness. What counts are delays, not
frames: those that a stall held back come in one burst, and only the first of them tells how long it
was. Two windows rate, and the longer wait counts: the slow one forgets trouble after some seconds,
the fast one needs only three delays in a second.
"""

import math
from bisect import bisect_left, bisect_right, insort
from collections import deque
from itertools import takewhile
from typing import NamedTuple

from pica_core.codec.latent_stream import LatentSample
from pica_protocol.frames import Frame, sequence_distance

LATE_S = 10.0
"""A frame of an earlier sequence that is later than this is no old one (chosen: a link that was
dead for so long has been closed)."""
WINDOW_S = 6.0
"""Time that is remembered: so long the delay stays up after trouble (chosen: short enough that a
call is fresh again soon, long enough to hold a share of 95 %)."""
ATTACK_S, ATTACK_QUANTILE, ATTACK_MIN_DELAYS = 1.0, 0.9, 10
"""The fast window, the share of it that is waited for, and how many delays say something of it."""
CAPACITY = 2048
"""Frames that the window holds; it drops its oldest beyond (chosen: 6 s at 240 fps and some)."""
MAX_DELAY_S = 1.0
"""A longer delay is not waited for at all: this machine slept, or the network stood."""
RESTART_FRAMES = 1000
"""A sequence this far behind is not late, and one this far ahead is no gap but a new beginning
(chosen: four seconds at 240 fps)."""
NUM_GAPS = 16
"""Gaps the interval is the median of (chosen: with a fifth of the frames left out it still stands,
and it follows a thinned stream after eight frames)."""


class ReceivedFrame(NamedTuple):
    """A frame off the wire with its place on the time line."""

    number: int
    """Counts the frames of the stream and never wraps; it leaps where the sender began again."""
    captured_us: int
    """Sender's clock as it was told, microseconds."""
    payload: bytes
    media_s: float
    """Capture time on the time line, seconds: the sender's clock, from an origin of the receiver's,
    with its jumps taken out."""


class DecodedFrame(NamedTuple):
    """A face with its place on the time line; fields as in `ReceivedFrame`."""

    captured_us: int
    sample: LatentSample
    media_s: float


class SenderClock:
    """The time line of one stream.

    Attributes:
        transit: How long frames take; None before the first frame.
    """

    def __init__(self, *, quantile: float = 0.95) -> None:
        """`quantile` is the share of delays that are waited for."""
        self.transit: Transit | None = None
        self._quantile = quantile
        # The newest frame, and the place of its clock on the time line.
        self._number = self._sequence = self._captured_us = 0
        self._origin_us, self._origin_s = 0, 0.0

    def media_s(self, captured_us: int) -> float:
        """The place of a capture time on the time line, as the newest frames have it."""
        # Subtracted as integers: a float of microseconds since 1970 has no room for fractions.
        return self._origin_s + (captured_us - self._origin_us) / 1e6

    def receive(self, frame: Frame, now: float) -> ReceivedFrame | None:
        """Place a frame that arrived just now; None: it came before, or a newer one did."""
        ahead = sequence_distance(frame.sequence, self._sequence)
        if self.transit is None:
            self.transit = Transit(now, quantile=self._quantile)
            self._origin_us, self._number, ahead = frame.captured_us, frame.sequence, 0
        elif self._begins(frame, ahead, now):
            self._origin_us, self._origin_s = frame.captured_us, now - self.transit.fastest_s
            self.transit = Transit(self.transit.fastest_s, quantile=self._quantile)
            ahead = RESTART_FRAMES + 1
        elif ahead <= 0:
            return None
        self._number, self._sequence = self._number + ahead, frame.sequence
        self._captured_us = frame.captured_us
        media_s = self.media_s(frame.captured_us)
        return ReceivedFrame(self._number, frame.captured_us, frame.payload, media_s)

    def _begins(self, frame: Frame, ahead: int, now: float) -> bool:
        """Return True if the frame contradicts the newest one, see the module."""
        assert self.transit is not None
        later_us = frame.captured_us - self._captured_us
        if abs(ahead) > RESTART_FRAMES or ahead * later_us < 0 or (ahead == 0 and later_us != 0):
            return True
        late_s = now - self.media_s(frame.captured_us) - self.transit.fastest_s
        return ahead < 0 and late_s > LATE_S


class _Arrival(NamedTuple):
    arrived_s: float
    transit_s: float
    is_alone: bool


class Transit:
    """How long the frames of one stream take.

    Attributes:
        fastest_s: Our clock minus the sender's for a frame that nothing delays.
        jitter_s: Lateness that should be waited for.
    """

    def __init__(self, transit_s: float, *, quantile: float = 0.95) -> None:
        self.fastest_s, self.jitter_s = transit_s, 0.0
        self._quantile = quantile
        self._arrivals: deque[_Arrival] = deque()
        self._ordered: list[float] = []  # their transits
        self._delays: list[float] = []  # the same of those that came alone
        self._last = (-math.inf, -math.inf)  # arrived_s, media_s

    def receive(self, media_s: float, arrived_s: float) -> None:
        """Take a frame into account."""
        transit_s = arrived_s - media_s
        last_arrived_s, last_media_s = self._last
        is_burst = arrived_s - last_arrived_s < 0.5 * (media_s - last_media_s)
        self._last = (arrived_s, media_s)
        arrivals, ordered, delays = self._arrivals, self._ordered, self._delays
        while arrivals and (
            arrivals[0].arrived_s < arrived_s - WINDOW_S or len(arrivals) >= CAPACITY
        ):
            old = arrivals.popleft()
            del ordered[bisect_left(ordered, old.transit_s)]
            if old.is_alone:
                del delays[bisect_left(delays, old.transit_s)]
        is_alone = not is_burst or not arrivals
        arrivals.append(_Arrival(arrived_s, transit_s, is_alone))
        insort(ordered, transit_s)
        if is_alone:
            insort(delays, transit_s)
        self.fastest_s = ordered[0]
        begin_s, longest_s = arrived_s - ATTACK_S, self.fastest_s + MAX_DELAY_S
        slow = delays[: bisect_right(delays, longest_s)]
        fast = sorted(
            each.transit_s
            for each in takewhile(lambda each: each.arrived_s >= begin_s, reversed(arrivals))
            if each.is_alone and each.transit_s <= longest_s
        )
        wait_s = _quantile(slow, self._quantile) if slow else self.fastest_s
        if len(fast) >= ATTACK_MIN_DELAYS:
            wait_s = max(wait_s, _quantile(fast, ATTACK_QUANTILE))
        self.jitter_s = max(wait_s - self.fastest_s, 0.0)


def _quantile(ordered: list[float], share: float) -> float:
    """The least of some rising values that this share of them does not exceed."""
    return ordered[math.ceil(share * len(ordered)) - 1]


class FrameInterval:
    """The time between two frames that arrive.

    Attributes:
        interval_s: The median of the last gaps; 0 until two frames have come.
    """

    def __init__(self) -> None:
        self.interval_s = 0.0
        self._gaps: deque[float] = deque(maxlen=NUM_GAPS)
        self._last: DecodedFrame | None = None

    def receive(self, frame: DecodedFrame) -> None:
        """Take the next frame into account."""
        last, self._last = self._last, frame
        # What follows a still frame is a silence on purpose, and no gap.
        if last is not None and not last.sample.is_still and frame.media_s > last.media_s:
            self._gaps.append(frame.media_s - last.media_s)
            self.interval_s = sorted(self._gaps)[(len(self._gaps) - 1) // 2]
