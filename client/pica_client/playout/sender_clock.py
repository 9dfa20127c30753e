"""From what a frame says of itself to its place on one even time line. Pure.

A frame names a sequence, which wraps and may begin anew, and a capture time on the sender's clock,
which may jump. Here it gets a `number` that never wraps and a `media_s` that goes on as our own
clock does, whatever the sender's does.

A frame that follows from those before it passes at once. One that cannot is held back, for it may
be one bad frame or the first of a new beginning, and only its followers can tell:

    what is wrong                                        if its followers agree
    far faster than the fastest and than the last one    the clock was set forward
    captured before a frame of a lower sequence          the clock was set back
    captured after a frame of a higher sequence          the sender began anew
    a sequence that we know, another capture time        the sender began anew
    a sequence far ahead of the newest or far behind it  the sender began anew
    far too late to be of any use                        both at once

Followers agree when sequence and capture time go on from the frame held back: `NUM_AGREEING` of
them, or fewer over `AGREEING_S` for a slow stream. Then the time line goes on from there: the
frames held back are placed as if the fastest of them had come the fastest way, and pass together.
If instead a frame comes that follows from the old ones, what is held back is refused and counted.

Where the sender began anew the numbers leap by more than `RESTART_FRAMES`: what is missing there
was not lost.
"""

from bisect import bisect_left
from typing import NamedTuple

from pica_client.playout.transit import RESTART_FRAMES, Transit
from pica_core.codec.latent_sample import ReceivedFrame
from pica_protocol.frames import SEQUENCE_MODULUS, Frame, sequence_distance, unwrap_sequence

FUTURE_S = 0.5
"""A frame this much faster than the fastest, and than the one before it, comes from the future
(chosen: more than twice the usual ceiling of the delay; smaller steps the clock map follows by
itself). After a stall at the very beginning frames are faster than the fastest one by one."""
LATE_S = 10.0
"""A late frame later than this belongs to another beginning (chosen: a link that was dead for so
long has been closed)."""
NUM_AGREEING = 3
"""Frames that must agree before they are believed (chosen: 67 ms at 30 fps, which the display
bridges unseen)."""
AGREEING_S = 0.5
"""Two frames that agree over this time are enough (chosen: for streams below 4 fps)."""


class _Arrival(NamedTuple):
    frame: Frame
    arrived_s: float


class SenderClock:
    """The time line of one stream.

    Attributes:
        transit: How long frames take; None before the first frame.
        num_jumps: How often the sender or its clock began anew.
        num_refused: Frames that fitted neither what came before nor what came after.
        num_future: Of these, frames from the future.
        num_duplicates: Frames that came again while they were held back.
    """

    def __init__(self, *, quantile: float = 0.95) -> None:
        """`quantile` is the share of delays that are waited for."""
        self.transit: Transit | None = None
        self._quantile = quantile
        self.num_jumps = self.num_refused = self.num_future = self.num_duplicates = 0
        self._held_back: list[_Arrival] = []  # fewer than NUM_AGREEING
        self._held_future = 0
        self._recent: list[tuple[int, int]] = []  # number and capture time; drops the lowest
        # The newest frame that passed, and the place of its clock on the time line.
        self._newest_number = self._newest_us = 0
        self._newest_transit_s = 0.0
        self._origin_us, self._origin_s = 0, 0.0

    @property
    def num_held_back(self) -> int:
        """Frames that nothing can be said of yet."""
        return len(self._held_back)

    @property
    def offset_s(self) -> float:
        """Our clock minus the sender's for the newest frame, had it come the fastest way."""
        if self.transit is None:
            return 0.0
        return self.media_s(self._newest_us) + self.transit.fastest_s - self._newest_us / 1e6

    def receive(self, frame: Frame, now: float) -> list[ReceivedFrame]:
        """Take a frame that arrived just now.

        Returns:
            The frames that pass: this one, none, or after a new beginning those held back, too. The
            first of a new beginning may lie before frames that passed earlier and were wrong.
        """
        arrival = _Arrival(frame, now)
        if self.transit is None:
            self.transit = Transit(now, quantile=self._quantile)
            self._newest_number = frame.sequence
            self._begin(arrival, media_s=0.0)
        else:
            transit_s = now - self.media_s(frame.captured_us)
            lateness_s = transit_s - self.transit.fastest_s
            is_future = min(-lateness_s, self._newest_transit_s - transit_s) > FUTURE_S
            is_old = sequence_distance(frame.sequence, self._newest_number) < 0
            if is_future or self._breaks_count(frame) or (is_old and lateness_s > LATE_S):
                return self._hold_back(arrival, is_future=is_future)
        self._refuse_held_back()
        return [self._pass(arrival)]

    def _begin(self, arrival: _Arrival, media_s: float) -> None:
        """Place a frame on the time line, and what follows after it."""
        self._origin_us, self._origin_s = arrival.frame.captured_us, media_s
        self._newest_us = arrival.frame.captured_us

    def media_s(self, captured_us: int) -> float:
        """The place of a capture time on the time line, as the newest frames have it."""
        # Subtracted as integers: a float of microseconds since 1970 has no room for fractions.
        return self._origin_s + (captured_us - self._origin_us) / 1e6

    def _breaks_count(self, frame: Frame) -> bool:
        """Whether sequence and capture time cannot be those of a frame between the known ones."""
        number = unwrap_sequence(frame.sequence, self._newest_number)
        if abs(number - self._newest_number) > RESTART_FRAMES:
            return True
        place = bisect_left(self._recent, (number,))
        if place < len(self._recent):
            known, captured_us = self._recent[place]
            if known == number:
                return captured_us != frame.captured_us
            if captured_us < frame.captured_us:
                return True
        return place > 0 and self._recent[place - 1][1] > frame.captured_us

    def _pass(self, arrival: _Arrival) -> ReceivedFrame:
        frame = arrival.frame
        number = unwrap_sequence(frame.sequence, self._newest_number)
        media_s = self.media_s(frame.captured_us)
        if number >= self._newest_number:
            self._newest_number, self._newest_us = number, frame.captured_us
            self._newest_transit_s = arrival.arrived_s - media_s
        known = (number, frame.captured_us)
        place = bisect_left(self._recent, known)
        if self._recent[place : place + 1] != [known]:
            self._recent.insert(place, known)
            del self._recent[:-RESTART_FRAMES]
        return ReceivedFrame(
            number=number,
            captured_us=frame.captured_us,
            payload=frame.payload,
            media_s=media_s,
            arrived_s=arrival.arrived_s,
        )

    def _hold_back(self, arrival: _Arrival, *, is_future: bool) -> list[ReceivedFrame]:
        """Keep a frame until its followers tell what it is; let all pass once they have."""
        if self._held_back:
            last, frame = self._held_back[-1].frame, arrival.frame
            ahead = sequence_distance(frame.sequence, last.sequence)
            if ahead == 0 and frame.captured_us == last.captured_us:
                self.num_duplicates += 1
                return []
            if not (0 < ahead <= RESTART_FRAMES and _goes_on(self._held_back[-1], arrival)):
                self._refuse_held_back()
        self._held_back.append(arrival)
        self._held_future += is_future
        waited_s = arrival.arrived_s - self._held_back[0].arrived_s
        if len(self._held_back) < NUM_AGREEING and (
            len(self._held_back) < 2 or waited_s < AGREEING_S
        ):
            return []
        arrivals, self._held_back, self._held_future = self._held_back, [], 0
        self._begin_anew(arrivals)
        return [self._pass(each) for each in arrivals]

    def _begin_anew(self, arrivals: list[_Arrival]) -> None:
        """Let the time line go on with frames that agree."""
        self.num_jumps += 1
        first = arrivals[0].frame
        number = unwrap_sequence(first.sequence, self._newest_number)
        if not 0 < number - self._newest_number <= RESTART_FRAMES:  # else only the clock jumped
            above = self._newest_number + RESTART_FRAMES + SEQUENCE_MODULUS // 2 + 1
            number = unwrap_sequence(first.sequence, above)
        self._newest_number = number
        self._recent.clear()
        assert self.transit is not None
        media_s = -self.transit.fastest_s + min(
            arrived_s - (frame.captured_us - first.captured_us) / 1e6
            for frame, arrived_s in arrivals
        )
        self._begin(arrivals[0], media_s)

    def _refuse_held_back(self) -> None:
        self.num_refused += len(self._held_back)
        self.num_future += self._held_future
        self._held_back, self._held_future = [], 0


def _goes_on(before: _Arrival, after: _Arrival) -> bool:
    """Whether one frame can follow another on one clock."""
    captured_s = (after.frame.captured_us - before.frame.captured_us) / 1e6
    transit_change_s = after.arrived_s - before.arrived_s - captured_s
    return captured_s >= 0 and -LATE_S <= transit_change_s <= LATE_S
