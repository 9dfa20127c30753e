"""From what a frame says of itself to its place on one even time line. Pure.

A frame names a sequence, which wraps and may begin anew, and a capture time on the sender's clock,
which may jump. Playing wants neither: here a frame gets a `number` that only ever grows and a
`media_s` that goes on as our own clock does, whatever the sender's clock does.

A frame that follows from those before it passes at once. One that cannot is held back, for it may
be one bad frame or the first of a new beginning, and only its followers can tell:

    what is wrong                                       if its followers agree
    captured before frames of a lower sequence          the clock was set back
    far faster than the fastest and than the last one   the clock was set forward
    sequence falls while captured later, or far back    the sender began anew
    same sequence, another capture time                 the sender began anew
    far too late to be of any use                       both at once

Followers agree when sequence and capture time go on from the frame held back: `NUM_AGREEING` of
them, or fewer over `AGREEING_S` for a slow stream. Then the time line goes on from there: the
frames held back are placed as if the fastest of them had come the fastest way, and pass together.
If instead a frame comes that follows from the old ones, what is held back is refused and counted.
"""

from __future__ import annotations

from typing import NamedTuple

from pica_client.playout.clock_map import ClockMap
from pica_client.playout.timed_sample import TimedSample
from pica_core.codec.latent_sample import LatentSample
from pica_protocol.frames import sequence_distance

FUTURE_S = 0.5
"""A frame this much faster than the fastest, and than the one before it, comes from the future
(chosen: more than twice the usual ceiling of the delay; smaller steps the clock map follows by
itself). After a stall at the very beginning frames are faster than the fastest one by one."""
LATE_S = 10.0
"""A late frame later than this belongs to another beginning (chosen: a link that was dead for so
long has been closed)."""
RESTART_FRAMES = 1000
"""A sequence this far behind is not late (chosen: four seconds at 240 fps)."""
NUM_AGREEING = 3
"""Frames that must agree before they are believed (chosen: 67 ms at 30 fps, which the display
bridges unseen)."""
AGREEING_S = 0.5
"""Two frames that agree over this time are enough (chosen: for streams below 4 fps)."""


class _Arrival(NamedTuple):
    sequence: int
    captured_us: int
    arrived_s: float
    sample: LatentSample


class SenderTime:
    """The time line of one stream.

    Attributes:
        clock: Transit of the fastest frames; None before the first frame.
        num_jumps: How often the sender or its clock began anew.
        num_refused: Frames that fitted neither what came before nor what came after.
        num_future: Of these, frames from the future.
        num_duplicates: Frames that came again while they were held back.
    """

    def __init__(self) -> None:
        self.clock: ClockMap | None = None
        self.num_jumps = self.num_refused = self.num_future = self.num_duplicates = 0
        self._held_back: list[_Arrival] = []  # fewer than NUM_AGREEING
        self._held_future = 0
        # The newest frame that passed, and the place of its clock on the time line.
        self._newest_sequence = self._newest_us = self._newest_number = 0
        self._newest_transit_s = 0.0
        self._origin_us, self._origin_s = 0, 0.0

    def receive(
        self, sequence: int, captured_us: int, sample: LatentSample, now: float
    ) -> list[TimedSample]:
        """Take a frame that arrived just now.

        Returns:
            The frames that pass: this one, none, or after a new beginning those held back, too. The
            first of a new beginning may lie before frames that passed earlier and were wrong.
        """
        arrival = _Arrival(sequence, captured_us, now, sample)
        clock = self.clock
        if clock is None:
            clock = self._begin(arrival, 0.0, now)
            self._newest_number = sequence
        elif (reason := self._contradiction(arrival, clock)) is not None:
            return self._hold_back(arrival, clock, is_future=reason == "future")
        self._refuse_held_back()
        return [self._pass(arrival)]

    def _begin(self, arrival: _Arrival, media_s: float, transit_s: float) -> ClockMap:
        """Place a frame on the time line, and what follows after it."""
        self._origin_us, self._origin_s = arrival.captured_us, media_s
        self._newest_sequence, self._newest_us = arrival.sequence, arrival.captured_us
        self.clock = ClockMap(media_s, transit_s)
        return self.clock

    def _media_s(self, captured_us: int) -> float:
        # Subtracted as integers: a float of microseconds since 1970 has no room for fractions.
        return self._origin_s + (captured_us - self._origin_us) / 1e6

    def _contradiction(self, arrival: _Arrival, clock: ClockMap) -> str | None:
        """Why a frame cannot follow from those that passed."""
        media_s = self._media_s(arrival.captured_us)
        transit_s = arrival.arrived_s - media_s
        lateness_s = transit_s - clock.fastest_transit_s(media_s)
        if max(lateness_s, transit_s - self._newest_transit_s) < -FUTURE_S:
            return "future"
        ahead = sequence_distance(arrival.sequence, self._newest_sequence)
        if ahead > 0:
            return "clock set back" if arrival.captured_us < self._newest_us else None
        if ahead == 0:
            return None if arrival.captured_us == self._newest_us else "begun anew"
        if arrival.captured_us > self._newest_us or ahead < -RESTART_FRAMES:
            return "begun anew"
        return "too late" if lateness_s > LATE_S else None

    def _pass(self, arrival: _Arrival) -> TimedSample:
        ahead = sequence_distance(arrival.sequence, self._newest_sequence)
        number = self._newest_number + ahead
        media_s = self._media_s(arrival.captured_us)
        if ahead >= 0:
            self._newest_sequence, self._newest_us = arrival.sequence, arrival.captured_us
            self._newest_number, self._newest_transit_s = number, arrival.arrived_s - media_s
        return TimedSample(
            sequence=arrival.sequence,
            captured_us=arrival.captured_us,
            arrived_s=arrival.arrived_s,
            sample=arrival.sample,
            number=number,
            media_s=media_s,
        )

    def _hold_back(
        self, arrival: _Arrival, clock: ClockMap, *, is_future: bool
    ) -> list[TimedSample]:
        """Keep a frame until its followers tell what it is; let all pass once they have."""
        if self._held_back:
            last = self._held_back[-1]
            ahead = sequence_distance(arrival.sequence, last.sequence)
            if ahead == 0 and arrival.captured_us == last.captured_us:
                self.num_duplicates += 1
                return []
            if not (0 < ahead <= RESTART_FRAMES and _goes_on(last, arrival)):
                self._refuse_held_back()
        self._held_back.append(arrival)
        self._held_future += is_future
        first = self._held_back[0]
        if len(self._held_back) < NUM_AGREEING and (
            len(self._held_back) < 2 or arrival.arrived_s - first.arrived_s < AGREEING_S
        ):
            return []
        self.num_jumps += 1
        arrivals, self._held_back, self._held_future = self._held_back, [], 0
        ahead = sequence_distance(first.sequence, self._newest_sequence)
        is_clock_only = 0 < ahead <= RESTART_FRAMES
        self._newest_number += ahead if is_clock_only else 1
        transit_s = clock.fastest_transit_s(self._media_s(self._newest_us))
        media_s = -transit_s + min(
            each.arrived_s - (each.captured_us - first.captured_us) / 1e6 for each in arrivals
        )
        self._begin(first, media_s, transit_s)
        return [self._pass(each) for each in arrivals]

    def _refuse_held_back(self) -> None:
        self.num_refused += len(self._held_back)
        self.num_future += self._held_future
        self._held_back, self._held_future = [], 0


def _goes_on(before: _Arrival, after: _Arrival) -> bool:
    """Whether one frame can follow another on one clock."""
    captured_s = (after.captured_us - before.captured_us) / 1e6
    transit_change_s = after.arrived_s - before.arrived_s - captured_s
    return captured_s >= 0 and -LATE_S <= transit_change_s <= LATE_S
