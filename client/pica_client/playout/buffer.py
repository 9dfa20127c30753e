"""From frames as the network delivers them to a face at display time. Pure: `now` is an argument.

    sender.receive(frame, now)   a frame arrived; returns those to be decoded now
    receive_frame(decoded)       a frame was decoded
    restart(decoded)             a frame was decoded after the stream was stopped on purpose
    sample_at(now)               the face now, for a display of any rate
    due_frames(now)              or instead: every frame once, when it is due (benches decode each)
    next_timer()                 when the next frame becomes due

Theory of operation. Every part has its module:

    sender_clock     a frame's sequence and capture time -> its place on one even time line,
                     whatever the sender's clock does; frames that fit nowhere are refused
    clock_map        that time line -> our clock: the transit of the fastest frames, and its drift
    jitter           how much longer than the fastest the others take
    frame_interval   the interval of the frames that arrive, and which were lost
    timeline         the frames in order, and the face's path through them
    playhead         the moment of the time line that the display is at
    motion           the face on its way, and what takes it back to its path without a snap

A frame captured at t is due at

    t + fastest transit + base + delay        base: what every recent frame took longer
    delay = floor + jitter, at most the ceiling

`sample_at` moves evenly between two frames, so it needs the next one before it is due: its floor is
one interval of the frames that arrive. `due_frames` lets every frame go as it is: its floor is only
what the jitter estimate does not see. When the delay changes, the display's time runs a little
faster or slower. When the path of the face changes (a frame comes after the face had to go on
without it), what is shown goes over to the new path within `blend_s`. Late frames never come here
for nothing: the decoder has used them to predict others, here they tell how long to wait.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

from pica_client.playout.config import PlayoutConfig
from pica_client.playout.frame_interval import FrameInterval
from pica_client.playout.jitter import JitterEstimate
from pica_client.playout.motion import Correction
from pica_client.playout.playhead import Playhead
from pica_client.playout.sender_clock import SenderClock
from pica_client.playout.timeline import Timeline
from pica_core.codec.latent_sample import DecodedFrame, LatentSample

MAX_LAG_S = 0.03
"""Most that a face whose frames are late lets its voice go ahead (chosen: with a step of the
display below the 45 ms of ITU-R BT.1359)."""
MAX_LED_S = 2.0
"""A voice farther from its face is of another clock, or of a sender that lies."""


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
    age_s: float
    """Age of information: time since the moment shown, less the fastest transit (which clocks
    cannot tell from their offset)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PlayoutReport:
    """Counters since the stream began, and how it stands."""

    received: int = 0
    lost: int = 0
    """Frames known to be lost on their way, or dropped here because too many waited. A hole that
    thinning leaves is no loss; which it was is known eight frames later."""
    late: int = 0
    """Frames that came after a newer one was shown."""
    duplicates: int = 0
    refused: int = 0
    """Frames that fit nowhere on the time line."""
    future: int = 0
    """Refused frames that came from the future."""
    restarts: int = 0
    """How often sender or its clock began anew."""
    shown: int = 0
    """Display times with a face, or frames released."""
    concealed: int = 0
    """Display times, or holes in the released frames, without a fresh face."""
    leaps: int = 0
    """How often the display leapt forwards because it was too far behind."""
    delay_s: float = 0.0
    """What the face waits beyond the fastest transit; follows `target_s` smoothly."""
    target_s: float = 0.0
    """What it should wait."""
    jitter_s: float = 0.0
    """Lateness that is waited for."""
    interval_s: float = 0.0
    """Time between two frames that arrive; 0 until two have come."""
    drift_ppm: float = 0.0
    """How much faster the sender's clock runs than ours, parts in a million."""
    offset_s: float = 0.0
    """Our clock minus the sender's, with what the fastest frame took, which cannot be told apart:
    between two machines it may be anything, and so may be what somebody calls a latency."""
    age_s: float = 0.0
    """`PlayedFace.age_s` of the last face."""
    largest_correction: float = 0.0
    """Largest step of one display time that was not the face's own motion: root mean square over
    the numbers of the latent."""

    @property
    def concealed_ratio(self) -> float:
        """Share of display times without a fresh face."""
        return self.concealed / self.shown if self.shown else 0.0

    def since(self, before: PlayoutReport) -> PlayoutReport:
        """This report with all counters begun anew at an earlier one."""
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
        self._received = self._late = self._duplicates = self._misplaced = self._num_cut = 0
        self._num_shown = self._concealed = 0
        self.sender, self._num_jumps = SenderClock(), 0
        self._timeline = Timeline(config)
        self._jitter = JitterEstimate(quantile=config.jitter_quantile, window_s=config.window_s)
        self._interval = FrameInterval()
        self._media = Playhead(config)
        self._correction = Correction(seconds=config.blend_s, limit=config.correction_limit)
        self._shown: LatentSample | None = None  # the last face of `sample_at`
        self._end_s = math.inf  # where it had stopped to move, on the time line
        self._is_path_new = False
        self._delay_s: float | None = None
        self._age_s = 0.0

    def receive_frame(self, frame: DecodedFrame) -> None:
        """Take a frame that `sender` let pass and that could be decoded just now."""
        self._received += 1
        if self.sender.num_jumps > self._num_jumps:
            self._num_jumps = self.sender.num_jumps
            self._num_cut += self._timeline.cut(frame.media_s)
        self._place(frame)

    def restart(self, frame: DecodedFrame) -> None:
        """Take the newest frame of a stream that we had stopped on purpose, and show it at once.

        Nothing is moved to it from what was shown before, and what was kept for us on the way says
        nothing about the network: neither jitter nor loss is learned from it.
        """
        self._received += 1
        self._num_jumps = self.sender.num_jumps
        self._interval.pause()
        if self._timeline.insert(frame) != "new":
            self._timeline = Timeline(self.config)
            self._timeline.insert(frame)
        self._timeline.restart()
        self._interval.receive(frame)
        self._interval.pause()  # what lies between this frame and the next was not sent
        self._correction.end()
        self._shown, self._is_path_new = None, False

    def sample_at(self, now: float, heard_us: int | None = None) -> PlayedFace | None:
        """The face to show at `now`, or None before the first frame is due.

        Args:
            now: Our clock.
            heard_us: The moment, on the sender's clock, of the voice that is heard just now. It
                leads: the face waits for it, and falls behind it by `MAX_LAG_S` at most.
        """
        clock, timeline, interval_s = self.sender.map, self._timeline, self._interval.interval_s
        if clock is None:
            return None
        should_s = own_s = clock.media_s(now) - self._target_s(is_displayed=True)
        if heard_us is not None:
            heard_s = self.sender.media_s(heard_us)
            if abs(heard_s - own_s) <= MAX_LED_S:
                should_s = min(max(own_s, heard_s - MAX_LAG_S), heard_s)
            else:
                heard_us = None
        if timeline.held is None and (
            timeline.following is None or timeline.following.media_s > should_s
        ):
            return None
        step = self._media.advance(now, should_s, self._end_s, is_led=heard_us is not None)
        position_s = self._media.position_s
        timeline.release(position_s)
        face = timeline.face_at(position_s, interval_s)
        if self._shown is not None:
            if self._is_path_new or step.is_leap:
                meant = timeline.face_at(position_s - step.moved_s, interval_s)
                self._correction.aim(self._shown, meant)
            face = self._correction.corrected(face, step.elapsed_s)
        self._shown, self._is_path_new = face, False
        self._delay_s = clock.media_s(now) - position_s
        return self._played(face, position_s, now)

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
        sender, clock = self.sender, self.sender.map
        target_s = 0.0 if clock is None else self._target_s(is_displayed=self._shown is not None)
        return PlayoutReport(
            received=self._received
            + sender.num_duplicates
            + sender.num_refused
            + sender.num_held_back,
            lost=self._interval.num_lost + self._timeline.num_overflowed + self._num_cut,
            late=self._late,
            duplicates=self._duplicates + sender.num_duplicates,
            refused=self._misplaced + sender.num_refused,
            future=sender.num_future,
            restarts=sender.num_jumps,
            shown=self._num_shown,
            concealed=self._concealed,
            leaps=self._media.num_leaps,
            delay_s=target_s if self._delay_s is None else self._delay_s,
            target_s=target_s,
            jitter_s=self._jitter.jitter_s,
            interval_s=self._interval.interval_s,
            drift_ppm=0.0 if clock is None else clock.drift_ppm,
            offset_s=sender.offset_s,
            age_s=self._age_s,
            largest_correction=self._correction.largest_step,
        )

    def _place(self, frame: DecodedFrame) -> None:
        """Put a frame where it belongs, and let it tell how the network is."""
        insertion = self._timeline.insert(frame)
        match insertion:
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
        clock = self.sender.map
        assert clock is not None
        self._jitter.receive(frame.arrived_s, frame.media_s, clock)
        self._interval.receive(frame)

    def _target_s(self, *, is_displayed: bool) -> float:
        """What should be waited beyond the fastest transit."""
        config, jitter = self.config, self._jitter
        smooth_s = config.floor_intervals * self._interval.interval_s if is_displayed else 0.0
        delay_s = max(config.floor_s, smooth_s) + jitter.jitter_s
        return jitter.base_s + min(delay_s, config.ceiling_s)

    def _local_s(self, media_s: float) -> float:
        """Our clock when a frame captured then comes the fastest way."""
        assert self.sender.map is not None
        return media_s + self.sender.map.fastest_transit_s(media_s)

    def _played(self, face: LatentSample, position_s: float, now: float) -> PlayedFace:
        """Say of a face how fresh it is, and remember where it stands."""
        config, timeline, interval_s = self.config, self._timeline, self._interval.interval_s
        held, following = timeline.held, timeline.following
        assert held is not None
        past_s = position_s - held.media_s
        newest, known_s, is_concealed = held, held.media_s, False
        self._end_s = math.inf
        if following is not None and timeline.is_under_way(position_s, interval_s):
            newest, known_s = following, position_s
        elif held.sample.is_still:
            known_s += min(past_s, config.still_s)
            is_concealed = past_s > config.still_s
        else:
            self._end_s = held.media_s + config.extrapolate_s
            # By now the next frame should have come, had it been as late as we wait for: half an
            # interval is granted for a tracker that is not so regular.
            waited_s = self._target_s(is_displayed=True) - self._jitter.base_s
            granted_s = max(waited_s - self._jitter.jitter_s, 0.0)
            is_concealed = past_s > 1.5 * interval_s - granted_s and interval_s > 0
        self._num_shown += 1
        self._concealed += is_concealed
        self._age_s = now - self._local_s(known_s)
        return PlayedFace(
            sample=face,
            captured_us=held.captured_us + round((known_s - held.media_s) * 1e6),
            newest=newest,
            is_concealed=is_concealed,
            age_s=self._age_s,
        )
