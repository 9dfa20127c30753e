"""From frames as the network delivers them to a face at display time. Pure: `now` is an argument.

    sender.receive(frame, now)   a frame arrived; returns it with its place in time, to be decoded
    receive_frame(decoded)       a frame was decoded
    sample_at(now)               the face now, for a display of any rate
    due_frames(now)              or instead: every frame once, when it is due (benches decode each)
    next_timer()                 when the next frame becomes due
    pause()                      the stream was stopped on purpose

Theory of operation. Every part has its module:

    sender_clock     a frame's sequence and capture time -> its place on one even time line,
                     whatever the sender's clock does
                     and that time line -> our clock: the transit of the fastest frames, how much
                     longer the others take, how often they come, which were lost
    motion           the moment of the time line that the display is at, the frames in order, the
                     face's path through them, and back to it

A frame captured at t is due at

    t + fastest transit + delay        delay = floor + jitter, at most the ceiling

`sample_at` moves evenly between two frames, so it needs the next one before it is due: its floor is
one interval of the frames that arrive. A display that is slower than the stream needs no such
buffer: a face that comes by as much later as its images lie farther apart than the frames is shown
with the same image. So its delay is shorter by that much, and it shows the newest frame at most,
never a guess. `due_frames` lets every frame go as it is: its floor is only what the jitter estimate
does not see. When the delay changes, the display's time runs a little faster or slower. When the
path of the face changes (a frame comes after the face had to go on without it), what is shown goes
over to the new path within `blend_s`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

from pica_client.playout.motion import COAST_S, Correction, Playhead, Timeline
from pica_client.playout.sender_clock import FrameInterval, SenderClock
from pica_core.codec.latent_stream import DecodedFrame, LatentSample
from pica_core.errors import check_ranges

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


@dataclass(frozen=True, kw_only=True, slots=True)
class PlayoutConfig:
    """How patient a playout buffer is, and how it moves a face."""

    floor_s: float = 0.004
    """Least delay on top of the measured jitter (chosen: what a busy event loop adds between two
    frames)."""
    floor_intervals: float = 1.0
    """Least delay of `sample_at`, in frame intervals: with one, the next frame is there when the
    face begins to move towards it."""
    ceiling_s: float = 0.2
    """Longest delay (chosen: with 50 ms of network still above the 150 ms of G.114, so worse jitter
    is better concealed than waited for)."""
    blend_s: float = 0.15
    """Time in which the face goes over to its path after it had to leave it (chosen: a blink)."""

    def __post_init__(self) -> None:
        small = dict.fromkeys(("ceiling_s", "floor_intervals", "blend_s"), (0, 10))
        check_ranges(self, **small)
        check_ranges(self, floor_s=(0, self.ceiling_s))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlayedFace:
    """A face at display time."""

    sample: LatentSample
    captured_us: int
    """The moment shown, sender's clock: that of the frame, or between two when interpolated. While
    a face goes on without a frame it is the last frame's: nothing newer is known."""
    newest: DecodedFrame
    """The newest frame that went into it."""
    is_concealed: bool
    """Whether the frame that should be shown by now is not there."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PlayoutReport:
    """Counters since the stream began, and how it stands."""

    received: int = 0
    lost: int = 0
    """Frames known to be lost on their way. A hole that thinning leaves is no loss; which it was is
    known eight frames later."""
    late: int = 0
    """Frames that came after a newer one was shown."""
    duplicates: int = 0
    refused: int = 0
    """Frames that fit nowhere on the time line."""
    restarts: int = 0
    """How often the sender or its clock began again."""
    shown: int = 0
    """Display times with a face, or frames released."""
    missed_s: float = 0.0
    """Time by which frames came after the moment that they are waited for: what the network, and
    not the display, let a face stand still."""
    concealed: int = 0
    """Display times, or holes in the released frames, without a fresh face."""
    delay_s: float = 0.0
    """What the face waits beyond the fastest transit; follows `target_s` smoothly."""
    target_s: float = 0.0
    """What it should wait."""
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

    def since(self, before: PlayoutReport) -> PlayoutReport:
        """This report with all counters counted from an earlier one."""
        counted = {
            each.name: getattr(self, each.name) - getattr(before, each.name)
            for each in fields(self)
            if isinstance(getattr(self, each.name), int)
        }
        return replace(self, **counted)


class Playout:
    """The playout buffer of one stream; see the module for how it works.

    Use `sample_at` or `due_frames` on one buffer, not both.

    Attributes:
        sender: The sender's time; frames pass it before they are decoded.
    """

    def __init__(self, config: PlayoutConfig | None = None) -> None:
        self.config = config = config or PlayoutConfig()
        self._received = self._late = self._duplicates = self._misplaced = 0
        self._num_shown = self._concealed = 0
        self._missed_s = self._last_transit_s = 0.0
        self.sender, self._num_jumps = SenderClock(), 0
        self._timeline = Timeline()
        self._interval = FrameInterval()
        self._media = Playhead()
        self._correction = Correction(config.blend_s)
        self._shown: LatentSample | None = None  # the last face of `sample_at`
        self._end_s = math.inf  # where it had stopped to move, on the time line
        self._is_path_new = False
        self._delay_s: float | None = None
        self._age_s = 0.0

    def receive_frame(self, frame: DecodedFrame) -> None:
        """Take a frame that `sender` has placed and that could be decoded just now."""
        self._received += 1
        if self.sender.num_jumps > self._num_jumps:
            self._num_jumps = self.sender.num_jumps
            self._timeline.cut(frame.media_s)
        match self._timeline.insert(frame):
            case "new":
                self._is_path_new = True
            case "late":
                self._late += 1
            case "duplicate":
                self._duplicates += 1
                return
            case "misplaced":
                self._misplaced += 1
                return
        assert self.sender.transit is not None
        transit_s = frame.arrived_s - frame.media_s
        late_s = transit_s - self.sender.transit.fastest_s - self._wait_s
        # Frames that a stall held back come in one burst: only the first says how long it was.
        self._missed_s += max(min(late_s, transit_s - self._last_transit_s), 0.0)
        self._last_transit_s = transit_s
        self.sender.transit.receive(frame.media_s, frame.arrived_s)
        self._interval.receive(frame)

    def pause(self) -> None:
        """Note that the stream is stopped on purpose: what is not sent now is not lost."""
        self._interval.pause()

    def sample_at(self, now: float, heard_us: int | None = None) -> PlayedFace | None:
        """The face to show next, or None before the first frame is due.

        Args:
            now: Our clock.
            heard_us: The moment, on the sender's clock, of the voice that is heard when this face
                is seen. It leads: the face waits for it, and falls behind it by `MAX_LAG_S` at most
                where its frames are there.
        """
        transit, timeline, interval_s = (
            self.sender.transit,
            self._timeline,
            self._interval.interval_s,
        )
        if transit is None:
            return None
        own_s = should_s = now - transit.fastest_s - self._target_s(is_displayed=True)
        is_led = False
        if heard_us is not None:
            heard_s = self.sender.media_s(heard_us)
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

    def due_frames(self, now: float) -> list[DecodedFrame]:
        """Take every frame that has become due, in capture order, each exactly once."""
        frames = []
        while (timer := self.next_timer()) is not None and timer <= now:
            before = self._timeline.held
            frame = self._timeline.release_first()
            num_missing = 0
            if before is not None and not before.sample.is_still:
                gap_s = frame.media_s - before.media_s
                num_missing = self._interval.num_missing(frame.number - before.number - 1, gap_s)
            self._concealed += num_missing
            self._num_shown += 1 + num_missing
            self._age_s = now - self._local_s(frame.media_s)
            frames.append(frame)
        return frames

    def next_timer(self) -> float | None:
        """When `due_frames` will have something, or None."""
        following = self._timeline.following
        if following is None:
            return None
        return self._local_s(following.media_s) + self._target_s(is_displayed=False)

    @property
    def num_waiting(self) -> int:
        """Frames held that are not shown yet."""
        return self._timeline.num_waiting

    def report(self) -> PlayoutReport:
        """Counters since the stream began, and how it stands."""
        sender, transit = self.sender, self.sender.transit
        target_s = 0.0 if transit is None else self._target_s(is_displayed=self._shown is not None)
        return PlayoutReport(
            received=self._received,
            lost=self._interval.num_lost,
            late=self._late,
            duplicates=self._duplicates,
            refused=self._misplaced,
            restarts=sender.num_jumps,
            shown=self._num_shown,
            missed_s=self._missed_s,
            concealed=self._concealed,
            delay_s=target_s if self._delay_s is None else self._delay_s,
            target_s=target_s,
            jitter_s=0.0 if transit is None else transit.jitter_s,
            interval_s=self._interval.interval_s,
            age_s=self._age_s,
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
        config, transit = self.config, self.sender.transit
        assert transit is not None
        smooth_s = config.floor_intervals * self._interval.interval_s
        return min(max(config.floor_s, smooth_s) + transit.jitter_s, config.ceiling_s)

    def _target_s(self, *, is_displayed: bool) -> float:
        """What should be waited beyond the fastest transit."""
        config, transit = self.config, self.sender.transit
        assert transit is not None
        if is_displayed:
            return max(self._wait_s - self._slack_s, config.floor_s)
        return min(config.floor_s + transit.jitter_s, config.ceiling_s)

    def _local_s(self, media_s: float) -> float:
        """Our clock when a frame captured then comes the fastest way."""
        assert self.sender.transit is not None
        return media_s + self.sender.transit.fastest_s

    def _played(
        self, face: LatentSample, position_s: float, due_s: float, now: float
    ) -> PlayedFace:
        """Describe how fresh a face is, and remember where it stands.

        Args:
            due_s: Frames captured before it should have come by now.
        """
        timeline, interval_s = self._timeline, self._interval.interval_s
        held, following, transit = timeline.held, timeline.following, self.sender.transit
        assert held is not None
        assert transit is not None
        past_s = due_s - held.media_s
        newest, known_s, is_concealed = held, held.media_s, False
        self._end_s = math.inf
        if following is not None and timeline.is_under_way(position_s, interval_s):
            newest, known_s = following, position_s
        elif held.sample.is_still:
            known_s += min(max(past_s, 0.0), STILL_S)
            is_concealed = past_s > STILL_S
        else:
            self._end_s = held.media_s + COAST_S
            # By now the next frame should have come, had it been as late as we wait for: half an
            # interval is granted for a tracker that is not so regular.
            granted_s = max(self._target_s(is_displayed=True) - transit.jitter_s, 0.0)
            is_concealed = past_s > 1.5 * interval_s - granted_s and interval_s > 0
        self._num_shown += 1
        self._concealed += is_concealed
        self._age_s = now - self._local_s(known_s)
        return PlayedFace(
            sample=face,
            captured_us=held.captured_us + round((known_s - held.media_s) * 1e6),
            newest=newest,
            is_concealed=is_concealed,
        )
