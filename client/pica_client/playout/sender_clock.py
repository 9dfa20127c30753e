"""From what a frame says of itself to its place on one even time line. Pure.

A frame names a sequence, which wraps and may begin again, and a capture time on the sender's clock,
which may jump. Here it gets a `number` that never wraps and a `media_s` that goes on as our own
clock does, whatever the sender's does.

A frame that does not follow from the newest one is the first of a new beginning:

    what is wrong                                         what has happened
    far faster than the fastest and than the newest one   the clock was set forward
    captured before the newest, of a later sequence       the clock was set back
    captured after the newest, of an earlier sequence     the sender began again
    the sequence of the newest, another capture time      the sender began again
    a sequence far ahead of the newest or far behind it   the sender began again
    an earlier sequence that is far too late to be used   both at once

The time line goes on from there as if the frame had come the fastest way. A frame that is wrong by
itself makes two beginnings, its own and that of the next one: it is seen for a moment in the stream
of the sender who sent it. The numbers leap by more than `RESTART_FRAMES`: what is missing there was
not lost.
"""

from pica_client.playout.transit import RESTART_FRAMES, Transit
from pica_core.codec.latent_stream import ReceivedFrame
from pica_protocol.frames import Frame, sequence_distance

FUTURE_S = 0.5
"""A frame this much faster than the fastest, and than the newest, is of another clock (chosen: more
than twice the usual ceiling of the delay; smaller steps the transit follows by itself). After a
stall at the very beginning frames are faster than the fastest one by one."""

LATE_S = 10.0
"""A frame of an earlier sequence that is later than this belongs to another beginning (chosen: a
link that was dead for so long has been closed)."""


class SenderClock:
    """The time line of one stream.

    Attributes:
        transit: How long frames take; None before the first frame.
        num_jumps: How often the sender or its clock began again.
    """

    def __init__(self, *, quantile: float = 0.95) -> None:
        """`quantile` is the share of delays that are waited for."""
        self.transit: Transit | None = None
        self.num_jumps = 0
        self._quantile = quantile
        # The newest frame, and the place of its clock on the time line.
        self._number = self._sequence = self._captured_us = 0
        self._transit_s = 0.0
        self._origin_us, self._origin_s = 0, 0.0

    def media_s(self, captured_us: int) -> float:
        """The place of a capture time on the time line, as the newest frames have it."""
        # Subtracted as integers: a float of microseconds since 1970 has no room for fractions.
        return self._origin_s + (captured_us - self._origin_us) / 1e6

    def receive(self, frame: Frame, now: float) -> ReceivedFrame:
        """Place a frame that arrived just now."""
        ahead = sequence_distance(frame.sequence, self._sequence)
        if self.transit is None:
            self.transit = Transit(now, quantile=self._quantile)
            self._origin_us, self._number, ahead = frame.captured_us, frame.sequence, 0
        elif self._begins(frame, ahead, now):
            self.num_jumps += 1
            self._origin_us, self._origin_s = frame.captured_us, now - self.transit.fastest_s
            self.transit.forget()
            self._number, ahead = self._number + RESTART_FRAMES + 1, 0
        media_s, number = self.media_s(frame.captured_us), self._number + ahead
        if ahead >= 0:
            self._number, self._sequence = number, frame.sequence
            self._captured_us, self._transit_s = frame.captured_us, now - media_s
        return ReceivedFrame(
            number=number,
            captured_us=frame.captured_us,
            payload=frame.payload,
            media_s=media_s,
            arrived_s=now,
        )

    def _begins(self, frame: Frame, ahead: int, now: float) -> bool:
        """Return True if the frame does not follow from the newest one, see the module."""
        assert self.transit is not None
        later_us = frame.captured_us - self._captured_us
        if abs(ahead) > RESTART_FRAMES or ahead * later_us < 0 or (ahead == 0 and later_us != 0):
            return True
        transit_s = now - self.media_s(frame.captured_us)
        late_s = transit_s - self.transit.fastest_s
        is_future = max(late_s, transit_s - self._transit_s) < -FUTURE_S
        return is_future or (ahead < 0 and late_s > LATE_S)
