"""From frames as the network delivers them to a face at display time. Pure: `now` is an argument.

    receive(frame, sample, now)  a frame arrived, and could be decoded
    sample_at(now)               the face now, for a display of any rate

Theory of operation. `sender_clock` gives a frame its place on one even time line, whatever the
sender's clock does, and says how long the fastest frames take, how much longer the others, and how
often they come. Here are the moment of the time line that the display is at (`Playhead`), the
frames in order and the face's path through them (`Timeline`), and the way back to it
(`Correction`).

A frame captured at t is due at

    t + fastest transit + delay        delay = floor + jitter, at most the ceiling

The face moves evenly between two frames, so it needs the next one before it is due: the floor is
one interval of the frames that arrive. A display that is slower than the stream needs no such
buffer: a face that comes by as much later as its images lie farther apart than the frames is shown
with the same image. So its delay is shorter by that much, and it shows the newest frame at most,
never a guess. When the delay changes, following it at once would be seen: the display's time runs a
little faster or slower until it is there, never backwards, and leaps forwards only where that would
take too long. When the path of the face changes (a frame comes after the face had to rest without
it), what is shown goes over to the new path within `BLEND_S`.

Between two frames the face moves evenly from one to the other. Where the next frame is too far
away, or not there, it rests. It leaves for the next frame, if that is there, just so early that it
does not hurry. A still frame says that nothing moves until one interval before the next frame.
Latent, rotation vector and position each move on a straight line: two frames are so close together
that the head's turn between them differs from the shortest arc by less than is seen.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from pica_client.playout.sender_clock import DecodedFrame, FrameInterval, SenderClock
from pica_core.codec.latent_stream import LatentSample
from pica_core.types import LATENT_SHAPE, NUM_LATENT, FloatArray
from pica_protocol.frames import Frame

NUM_SHOWN = 9
"""Frames kept after they were shown: 33 ms at 240 fps, for where the face was an image ago."""
MAX_FRAMES = 64
"""Frames that wait; beyond it the oldest is dropped."""
MAX_GAP_S = 0.25
"""Longest time on the way between two frames; a longer gap is waited out first (chosen: 4 fps are
still moved evenly)."""
BLEND_S = 0.15
"""Time in which the face goes over to its path after it had to leave it (chosen: a blink)."""
UNSEEN = 1e-5
"""A difference below this, in any unit, is none."""

LEAP_S = 0.25
"""A display this far behind leaps, and the face goes over as after a gap."""
FASTER, SLOWER = 0.1, 0.25
"""Shares by which display time runs faster to catch up (chosen: speech 10 % faster looks natural)
and slower to fall back: more, for frames are late meanwhile."""
LED_RATE = 1.0
"""The same where a voice leads: it has been stretched already, and says how fast time goes."""
LED_LEAP_S = 0.04
"""A display this far behind the voice that leads it leaps: lips may be 45 ms late (ITU-R
BT.1359)."""
SMOOTHING = 0.1
"""Weight of a new display interval in the mean."""
MAX_STEP_S = 0.25
"""A longer step is a pause of the display."""

_media_s = attrgetter("media_s")


def blend(before: LatentSample, after: LatentSample, weight: float) -> LatentSample:
    """Move from one face towards another; a weight above 1 goes on beyond it."""
    if weight == 0:
        return before
    if weight == 1:
        return after
    one = _flat(before)
    return _face(one + np.float32(weight) * (_flat(after) - one))


def _flat(face: LatentSample) -> FloatArray:
    """Latent, rotation and translation one after the other, float32 ``[262]``."""
    return np.concatenate((face.latent.ravel(), face.rotation, face.translation_m))


def _face(flat: FloatArray, *, is_still: bool = False) -> LatentSample:
    latent = flat[:NUM_LATENT].reshape(LATENT_SHAPE)
    rotation, translation_m = flat[NUM_LATENT:].reshape(2, 3)
    return LatentSample(
        latent=latent, rotation=rotation, translation_m=translation_m, is_still=is_still
    )


class Correction:
    """Takes what is shown back to where it should be, within `BLEND_S`.

    What is shown is the true face plus an offset, which shrinks evenly to nothing; the true face
    moves on undamped below it.
    """

    def __init__(self) -> None:
        self._left_s = 0.0
        self._offset: FloatArray | None = None

    def aim(self, shown: LatentSample, true: LatentSample) -> None:
        """Begin to go from what is shown to what should have been at the same moment."""
        if shown is true and self._offset is None:
            return
        offset = _flat(shown) - _flat(true)
        if self._offset is not None and np.abs(offset - self._offset).max() < UNSEEN:
            return  # nothing new: what is under way goes on
        self._offset = offset if np.abs(offset).max() >= UNSEEN else None
        self._left_s = BLEND_S

    def corrected(self, true: LatentSample, elapsed_s: float) -> LatentSample:
        """The face to show instead of the true one, some time after the last."""
        if self._offset is None or self._left_s <= elapsed_s:
            self._offset = None
            return true
        self._offset = np.float32(1 - elapsed_s / self._left_s) * self._offset
        self._left_s -= elapsed_s
        return _face(_flat(true) + self._offset, is_still=true.is_still)


class Timeline:
    """Frames shown and to be shown."""

    def __init__(self) -> None:
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

    def append(self, frame: DecodedFrame) -> bool:
        """Take a frame that has just come, instead of those that wait and were captured later: they
        are of another beginning. Return False if one was shown that was captured later."""
        place = bisect_right(self._frames, frame.media_s, key=_media_s)
        if place < self._num_shown:
            return False
        self._frames[place:] = [frame]
        if self.num_waiting > MAX_FRAMES:
            del self._frames[self._num_shown]
        return True

    def release(self, media_s: float) -> None:
        """Count all frames captured up to then as shown."""
        self._num_shown = max(bisect_right(self._frames, media_s, key=_media_s), self._num_shown)
        num_old = max(self._num_shown - NUM_SHOWN, 0)
        del self._frames[:num_old]
        self._num_shown -= num_old

    def face_at(self, media_s: float, interval_s: float) -> LatentSample:
        """The face at a moment of the stream; a frame must have been shown."""
        place = max(bisect_right(self._frames, media_s, key=_media_s) - 1, 0)
        before = self._frames[place]
        departure_s = self._departure_s(place, interval_s)
        if media_s < departure_s:
            return before.sample
        after = self._frames[place + 1]
        share = (media_s - departure_s) / (after.media_s - departure_s)
        return blend(before.sample, after.sample, share)

    def is_under_way(self, media_s: float, interval_s: float) -> bool:
        """Whether the face is on its way to a frame that is there, rather than at rest."""
        place = max(bisect_right(self._frames, media_s, key=_media_s) - 1, 0)
        return self._departure_s(place, interval_s) <= media_s

    def _departure_s(self, place: int, interval_s: float) -> float:
        """When the face leaves a frame for the next; infinite while there is none."""
        if place + 1 >= len(self._frames):
            return math.inf
        before, after = self._frames[place : place + 2]
        longest_s = interval_s if before.sample.is_still and interval_s > 0 else MAX_GAP_S
        return max(before.media_s, after.media_s - longest_s)


class Step(NamedTuple):
    """The step from one display time to the next."""

    elapsed_s: float
    """Time that passed on our clock."""
    moved_s: float
    """How far the moment shown went on; where it leapt, how far it would have gone."""
    is_leap: bool = False


class Playhead:
    """The display's time of one stream.

    Attributes:
        position_s: The moment shown, on the stream's time line; minus infinity before the first.
        step_s: Mean time between two display times.
    """

    def __init__(self) -> None:
        self.position_s = -math.inf
        self.step_s = 0.0
        self._now = -math.inf

    def advance(self, now: float, target_s: float, end_s: float, *, is_led: bool = False) -> Step:
        """Go on to a display time.

        Args:
            now: Our clock.
            target_s: The moment that should be shown.
            end_s: The moment up to which the face last shown had moved: where the display stands
                still beyond it, falling back that far is not seen.
            is_led: Whether the target is what a voice says just now, rather than what is waited.
        """
        if self.position_s == -math.inf:
            self.position_s, self._now = target_s, now
            return Step(0.0, 0.0)
        elapsed_s = max(now - self._now, 0.0)
        self._now = max(now, self._now)
        if elapsed_s <= MAX_STEP_S:
            self.step_s += SMOOTHING * (elapsed_s - self.step_s)
        before_s = self.position_s
        behind_s = target_s - before_s - elapsed_s
        faster, slower = (LED_RATE, LED_RATE) if is_led else (FASTER, SLOWER)
        if behind_s > (LED_LEAP_S if is_led else LEAP_S):
            self.position_s = target_s
            return Step(elapsed_s, elapsed_s, is_leap=True)
        rate = min(max(behind_s, -slower * elapsed_s), faster * elapsed_s)
        position_s = before_s + elapsed_s + rate
        if end_s < position_s and target_s < position_s:
            position_s = max(target_s, min(end_s, position_s))
        self.position_s = position_s
        return Step(elapsed_s, max(position_s - before_s, 0.0))


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
