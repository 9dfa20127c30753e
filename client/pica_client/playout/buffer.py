"""From frames as the network delivers them to a face at display time. Pure: `now` is an argument.

    receive(frame, sample, now)  a frame arrived, and could be decoded
    sample_at(now)               the face now, for a display of any rate

Theory of operation. Every part has its module:

    sender_clock     a frame's sequence and capture time -> its place on one even time line,
                     whatever the sender's clock does
                     and that time line -> our clock: the transit of the fastest frames, how much
                     longer the others take, how often they come
    motion           the moment of the time line that the display is at, the frames in order, the
                     face's path through them, and back to it

A frame captured at t is due at

    t + fastest transit + delay        delay = floor + jitter, at most the ceiling

The face moves evenly between two frames, so it needs the next one before it is due: the floor is
one interval of the frames that arrive. A display that is slower than the stream needs no such
buffer: a face that comes by as much later as its images lie farther apart than the frames is shown
with the same image. So its delay is shorter by that much, and it shows the newest frame at most,
never a guess. When the delay changes, the display's time runs a little faster or slower. When the
path of the face changes (a frame comes after the face had to rest without it), what is shown goes
over to the new path within `motion.BLEND_S`.
"""

import math
from dataclasses import dataclass, replace

from pica_client.playout.motion import Correction, Playhead, Timeline
from pica_client.playout.sender_clock import DecodedFrame, FrameInterval, SenderClock
from pica_core.codec.latent_stream import LatentSample
from pica_protocol.frames import Frame

FLOOR_S = 0.004
"""Least delay on top of the measured jitter (chosen: what a busy event loop adds between two
frames)."""
CEILING_S = 0.2
"""Longest delay (chosen: with 50 ms of network still above the 150 ms of G.114, so worse jitter is
better concealed than waited for)."""
MAX_LAG_S = 0.03
"""Most that a face whose frames are late lets its voice go ahead (chosen: with a step of the
display below the 45 ms of ITU-R BT.1359)."""
MIN_SLACK_S = 0.005
"""A display whose images lie farther apart than the frames by less than this is as fast as they
are: clocks of trackers tremble."""
STILL_S = 2.5
"""How long a still face is believed without another word (chosen: two lost heartbeats)."""
MAX_LED_S = 2.0
"""A voice farther from its face is of another clock, or of a sender that lies."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlayedFace:
    """A face at display time."""

    sample: LatentSample
    captured_us: int
    """The moment shown, sender's clock: that of the frame, or between two when interpolated. While
    a face rests for want of a frame it is the last frame's: nothing newer is known."""
    is_concealed: bool
    """Whether the frame that should be shown by now is not there."""


@dataclass(kw_only=True, slots=True)
class PlayoutReport:
    """Counters since the stream began, and how it stands."""

    received: int = 0
    shown: int = 0
    """Display times with a face."""
    missed_s: float = 0.0
    """Time by which frames came after the moment that they are waited for: what the network, and
    not the display, let a face stand still."""
    concealed: int = 0
    """Display times without a fresh face."""
    delay_s: float = 0.0
    """What the face waits beyond the fastest transit; follows what it should wait smoothly."""
    jitter_s: float = 0.0
    """Lateness that is waited for."""
    interval_s: float = 0.0
    """Time between two frames that arrive; 0 until two have come."""
    age_s: float = 0.0
    """Age of information of the last face: time since the moment shown, less the fastest transit,
    which clocks cannot tell from their offset."""

    @property
    def concealed_ratio(self) -> float:
        """Share of display times without a fresh face."""
        return self.concealed / self.shown if self.shown else 0.0


class Playout:
    """The playout buffer of one stream; see the module for how it works."""

    def __init__(self) -> None:
        self._report = PlayoutReport()
        self._last_transit_s = 0.0
        self._sender = SenderClock()
        self._timeline = Timeline()
        self._interval = FrameInterval()
        self._media = Playhead()
        self._correction = Correction()
        self._shown: LatentSample | None = None  # the last face of `sample_at`
        self._end_s = math.inf  # where it had stopped to move, on the time line
        self._is_path_new = False
        self._delay_s: float | None = None

    def receive(self, frame: Frame, sample: LatentSample, now: float) -> None:
        """Take a frame that arrived just now, and the face that was decoded from it."""
        self._report.received += 1
        placed, transit = self._sender.receive(frame, now), self._sender.transit
        if placed is None or transit is None:
            return
        media_s = placed.media_s
        decoded = DecodedFrame(frame.captured_us, sample, media_s)
        if not self._timeline.append(decoded):
            return
        self._is_path_new = True
        transit_s = now - media_s
        late_s = transit_s - transit.fastest_s - self._wait_s
        # Frames that a stall held back come in one burst: only the first says how long it was.
        self._report.missed_s += max(min(late_s, transit_s - self._last_transit_s), 0.0)
        self._last_transit_s = transit_s
        transit.receive(media_s, now)
        self._interval.receive(decoded)

    def sample_at(self, now: float, heard_us: int | None = None) -> PlayedFace | None:
        """The face to show next, or None before the first frame is due.

        Args:
            now: Our clock.
            heard_us: The moment, on the sender's clock, of the voice that is heard when this face
                is seen. It leads: the face waits for it, and falls behind it by `MAX_LAG_S` at most
                where its frames are there.
        """
        transit, timeline = self._sender.transit, self._timeline
        if transit is None:
            return None
        interval_s = self._interval.interval_s
        own_s = should_s = now - transit.fastest_s - self._target_s
        is_led = False
        if heard_us is not None:
            heard_s = self._sender.media_s(heard_us)
            is_led = abs(heard_s - own_s) <= MAX_LED_S
            if is_led:
                should_s = min(max(own_s, heard_s - MAX_LAG_S), heard_s)
        if timeline.held is None and (
            timeline.following is None or timeline.following.media_s > should_s
        ):
            return None
        if self._slack_s > 0:
            should_s = min(should_s, timeline.newest_s)
        step = self._media.advance(now, should_s, self._end_s, is_led=is_led)
        position_s = self._media.position_s
        timeline.release(position_s)
        face = timeline.face_at(position_s, interval_s)
        if self._shown is not None:
            if self._is_path_new or step.is_leap:
                meant = timeline.face_at(position_s - step.moved_s, interval_s)
                self._correction.aim(self._shown, meant)
            face = self._correction.corrected(face, step.elapsed_s)
        self._shown, self._is_path_new = face, False
        self._delay_s = now - transit.fastest_s - position_s
        slack_s = self._slack_s  # what is not waited for on a slow display is not overdue, either
        return self._played(face, position_s, own_s - slack_s if slack_s else position_s, now)

    @property
    def num_waiting(self) -> int:
        """Frames held that are not shown yet."""
        return self._timeline.num_waiting

    def report(self) -> PlayoutReport:
        """Counters since the stream began, and how it stands."""
        transit = self._sender.transit
        target_s = 0.0 if transit is None else self._target_s
        return replace(
            self._report,
            delay_s=target_s if self._delay_s is None else self._delay_s,
            jitter_s=0.0 if transit is None else transit.jitter_s,
            interval_s=self._interval.interval_s,
        )

    @property
    def _slack_s(self) -> float:
        """By how much the display's images lie farther apart than the frames that arrive."""
        interval_s = self._interval.interval_s
        slack_s = self._media.step_s - interval_s
        return slack_s if interval_s > 0 and slack_s > MIN_SLACK_S else 0.0

    @property
    def _wait_s(self) -> float:
        """What frames are waited for beyond the fastest transit by a display that is as fast."""
        assert self._sender.transit is not None
        jitter_s = self._sender.transit.jitter_s
        return min(max(FLOOR_S, self._interval.interval_s) + jitter_s, CEILING_S)

    @property
    def _target_s(self) -> float:
        """What should be waited beyond the fastest transit."""
        return max(self._wait_s - self._slack_s, FLOOR_S)

    def _played(
        self, face: LatentSample, position_s: float, due_s: float, now: float
    ) -> PlayedFace:
        """Describe how fresh a face is, and remember where it stands.

        Args:
            due_s: Frames captured before it should have come by now.
        """
        timeline, interval_s = self._timeline, self._interval.interval_s
        held, following, transit = timeline.held, timeline.following, self._sender.transit
        assert held is not None
        assert transit is not None
        past_s = due_s - held.media_s
        known_s, is_concealed = held.media_s, False
        self._end_s = math.inf
        if following is not None and timeline.is_under_way(position_s, interval_s):
            known_s = position_s
        elif held.sample.is_still:
            known_s += min(max(past_s, 0.0), STILL_S)
            is_concealed = past_s > STILL_S
        else:
            self._end_s = held.media_s
            # By now the next frame should have come, had it been as late as we wait for: half an
            # interval is granted for a tracker that is not so regular.
            granted_s = max(self._target_s - transit.jitter_s, 0.0)
            is_concealed = past_s > 1.5 * interval_s - granted_s and interval_s > 0
        self._report.shown += 1
        self._report.concealed += is_concealed
        self._report.age_s = now - transit.fastest_s - known_s
        return PlayedFace(
            sample=face,
            captured_us=held.captured_us + round((known_s - held.media_s) * 1e6),
            is_concealed=is_concealed,
        )
