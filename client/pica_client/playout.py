"""From frames as the network delivers them to a face at display time. Pure: `now` is an argument.

Theory of operation. The transit time of a frame is its arrival on our clock minus its capture on
the sender's; the two clocks differ by an unknown offset, so only *differences* of transit times
mean anything. Over a window of recent frames the smallest transit is the fastest way through the
network, and how far the others lie above it is the jitter. A frame is due at

    capture + smallest transit + playout delay
    playout delay = floor + jitter (a high quantile), at most the ceiling

so the delay follows the network up at once and down as the window forgets. A frame later than that
is shown when it comes; it delays nobody else.

    receive_frame(frame, now)   it arrived; duplicates and frames older than the face are dropped
    sample_at(now)              the face now: interpolated between two frames where both are there,
                                else held
    due_frames(now)             or instead: every frame once, when it is due (benches decode each)
    next_timer()                when the next frame becomes due

What makes the window worthless starts it anew: a sender that begins again (its sequence falls back
while its clock goes on, or falls far back) and a sender's clock that jumps (capture times fall, or
transit drops by more than a network can explain).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from pica_client.rotation import blend_rotations
from pica_core.latent_sample import LatentSample
from pica_protocol.frames import SEQUENCE_MODULUS, sequence_distance


@dataclass(frozen=True, kw_only=True, slots=True)
class PlayoutConfig:
    """How patient a playout buffer is."""

    floor_s: float = 0.004
    """Delay on top of the measured jitter (chosen: what a busy event loop adds between two
    frames). One frame interval makes a slow stream smooth on a fast display, at that cost."""
    ceiling_s: float = 0.2
    """Longest playout delay (chosen: with 50 ms of network still above the 150 ms of G.114, so
    worse jitter is better concealed than waited for)."""
    jitter_quantile: float = 0.95
    """Share of frames that the delay waits for; the rest are shown late."""
    window_frames: int = 256
    """Frames that offset and jitter are measured over: 8.5 s at 30 a second."""
    max_frames: int = 64
    """Frames held; beyond it the oldest is dropped."""
    max_gap_s: float = 0.25
    """Longest hole that is interpolated across; a longer one is held and then jumped."""
    clock_jump_s: float = 1.0
    """Drop of the transit time between two frames that only a clock can explain."""
    restart_frames: int = 1000
    """A sequence this far behind is not late: the sender began anew."""

    def __post_init__(self) -> None:
        if not 0 <= self.floor_s <= self.ceiling_s <= 10:
            raise ValueError(
                f"floor_s is {self.floor_s} and ceiling_s {self.ceiling_s}; "
                "0 <= floor_s <= ceiling_s <= 10 is needed"
            )
        if not 0 < self.jitter_quantile <= 1:
            raise ValueError(f"jitter_quantile is {self.jitter_quantile}; (0, 1] is allowed")
        for name, low, high in (
            ("window_frames", 1, 10_000),
            ("max_frames", 2, 1000),
            ("restart_frames", 1, 30_000),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} is {getattr(self, name)}; {low} to {high} is allowed")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TimedSample:
    """One frame of a stream, decoded, with its arrival."""

    sequence: int
    """As on the wire, 0 to 65535."""
    captured_us: int
    """Sender's clock, microseconds."""
    arrived_s: float
    """Our clock, seconds."""
    sample: LatentSample

    @property
    def captured_s(self) -> float:
        """Sender's clock, seconds."""
        return self.captured_us / 1e6


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlayedFace:
    """A face at display time."""

    sample: LatentSample
    captured_us: int
    """The moment shown, sender's clock: that of the frame, or between two when interpolated."""
    newest: TimedSample
    """The newest frame that went into it."""
    is_concealed: bool
    """Whether the frame that should be shown by now is not there."""
    age_s: float
    """Time since the moment shown, less the fastest transit (which clocks cannot tell apart)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PlayoutReport:
    """Counters since the stream began, and where the delay stands."""

    received: int = 0
    lost: int = 0
    """Frames never shown: dropped on the way, too late, or overflowed here."""
    late: int = 0
    """Frames that came after a newer one was shown."""
    duplicates: int = 0
    concealed: int = 0
    """Display times, or holes in the released frames, without a fresh face."""
    restarts: int = 0
    """How often sender or its clock began anew."""
    delay_s: float = 0.0
    """Playout delay: what we add to the fastest transit."""
    interval_s: float = 0.0
    """Between two frames at the sender; 0 until two have come."""


class Playout:
    """The playout buffer of one stream; see the module for how it works."""

    def __init__(self, config: PlayoutConfig | None = None) -> None:
        self.config = config or PlayoutConfig()
        self._received = self._lost = self._late = self._duplicates = 0
        self._concealed = self._restarts = 0
        self._held: TimedSample | None = None
        self._begin()

    def _begin(self) -> None:
        """Forget everything that depends on the sender's clock and sequence."""
        # Drops its oldest transit when full.
        self._transits: deque[float] = deque(maxlen=self.config.window_frames)
        self._newest: tuple[int, int] | None = None  # (unwrapped sequence, captured_us)
        # Not yet shown, by unwrapped sequence; drops its oldest when full.
        self._waiting: list[tuple[int, TimedSample]] = []
        self._shown_number: int | None = None
        self._position_s = -math.inf
        self._interval_s = 0.0
        self._smallest_s = 0.0
        self._due_s = 0.0  # smallest transit plus playout delay

    def receive_frame(
        self, sequence: int, captured_us: int, sample: LatentSample, now: float
    ) -> None:
        """Take a frame that arrived just now."""
        self._received += 1
        frame = TimedSample(
            sequence=sequence, captured_us=captured_us, arrived_s=now, sample=sample
        )
        transit = now - frame.captured_s
        if self._newest is not None and self._is_anew(frame, transit):
            self._restarts += 1
            self._lost += len(self._waiting)
            self._begin()  # the last face stays up until the first one of the new time is due
        number = self._unwrap(sequence)
        if self._shown_number is not None and number <= self._shown_number:
            if number == self._shown_number:
                self._duplicates += 1
            else:
                self._late += 1
            return
        place = len(self._waiting)
        while place and self._waiting[place - 1][0] >= number:
            place -= 1
        if place < len(self._waiting) and self._waiting[place][0] == number:
            self._duplicates += 1
            return
        self._measure(number, frame, transit)
        self._waiting.insert(place, (number, frame))
        if len(self._waiting) > self.config.max_frames:
            del self._waiting[0]  # shows up as a hole, and so as lost, when the next one is shown

    def sample_at(self, now: float) -> PlayedFace | None:
        """The face to show at `now`, or None before the first frame is due."""
        # Time never runs backwards on the display, even when the delay has just grown.
        self._position_s = position_s = max(self._position_s, now - self._due_s)
        while self._waiting and self._waiting[0][1].captured_s <= position_s:
            self._show_first()
        held = self._held
        if held is None:
            return None
        if self._shown_number is None:  # the sender has begun anew; its clock says nothing of this
            self._concealed += 1
            return PlayedFace(
                sample=held.sample,
                captured_us=held.captured_us,
                newest=held,
                is_concealed=True,
                age_s=now - held.arrived_s,
            )
        sample, captured_us, newest, is_concealed = held.sample, held.captured_us, held, False
        past_s = position_s - held.captured_s
        if self._waiting:
            following = self._waiting[0][1]
            gap_s = following.captured_s - held.captured_s
            if 0 < past_s < gap_s <= self.config.max_gap_s:
                sample = _blend(held.sample, following.sample, past_s / gap_s)
                captured_us, newest = round(position_s * 1e6), following
        else:
            is_concealed = past_s > 1.5 * self._interval_s > 0
            self._concealed += is_concealed
        return PlayedFace(
            sample=sample,
            captured_us=captured_us,
            newest=newest,
            is_concealed=is_concealed,
            age_s=now - self._smallest_s - captured_us / 1e6,
        )

    def due_frames(self, now: float) -> list[TimedSample]:
        """Take every frame that has become due, in capture order, each exactly once.

        Use this or `sample_at` on one buffer, not both.
        """
        lost_before = self._lost
        frames = []
        while (timer := self.next_timer()) is not None and timer <= now:
            frames.append(self._show_first())
        self._concealed += self._lost - lost_before
        return frames

    def next_timer(self) -> float | None:
        """When `due_frames` will have something, or None."""
        return self._waiting[0][1].captured_s + self._due_s if self._waiting else None

    @property
    def num_waiting(self) -> int:
        """Frames held that are not shown yet."""
        return len(self._waiting)

    def report(self) -> PlayoutReport:
        """Counters since the stream began."""
        return PlayoutReport(
            received=self._received,
            lost=self._lost,
            late=self._late,
            duplicates=self._duplicates,
            concealed=self._concealed,
            restarts=self._restarts,
            delay_s=self._due_s - self._smallest_s,
            interval_s=self._interval_s,
        )

    def _is_anew(self, frame: TimedSample, transit: float) -> bool:
        """Whether this frame belongs to another beginning of the sender, or of its clock."""
        newest_number, newest_captured_us = self._newest or (0, 0)
        ahead = sequence_distance(frame.sequence, newest_number % SEQUENCE_MODULUS)
        if ahead < 0:  # a late frame was captured before the newest one
            is_newer = frame.captured_us > newest_captured_us
            return is_newer or ahead < -self.config.restart_frames
        if ahead == 0:
            return False
        fell = frame.captured_us < newest_captured_us
        return fell or transit < self._smallest_s - self.config.clock_jump_s

    def _unwrap(self, sequence: int) -> int:
        """The sequence as a number that never wraps."""
        if self._newest is None:
            return sequence
        return self._newest[0] + sequence_distance(sequence, self._newest[0] % SEQUENCE_MODULUS)

    def _measure(self, number: int, frame: TimedSample, transit: float) -> None:
        """Let a frame move the estimates of offset, jitter and frame interval."""
        if self._newest is None or number > self._newest[0]:
            if self._newest is not None:
                steps = number - self._newest[0]
                interval_s = (frame.captured_us - self._newest[1]) / 1e6 / steps
                # One eighth of the way each time: the usual weight of a smoothed estimate
                # (RFC 6298 2.3), quick enough for a sender that changes its rate.
                share = 0.125 if self._interval_s else 1.0
                self._interval_s += share * (interval_s - self._interval_s)
            self._newest = (number, frame.captured_us)
        self._transits.append(transit)
        ordered = sorted(self._transits)
        rank = math.ceil(self.config.jitter_quantile * len(ordered)) - 1
        self._smallest_s = ordered[0]
        jitter_s = ordered[rank] - ordered[0]
        self._due_s = ordered[0] + min(self.config.floor_s + jitter_s, self.config.ceiling_s)

    def _show_first(self) -> TimedSample:
        """Take the oldest waiting frame as the one that is shown."""
        number, frame = self._waiting.pop(0)
        if self._shown_number is not None:
            self._lost += number - self._shown_number - 1
        self._shown_number, self._held = number, frame
        return frame


def _blend(before: LatentSample, after: LatentSample, weight: float) -> LatentSample:
    share = np.float32(weight)
    return LatentSample(
        latent=before.latent + share * (after.latent - before.latent),
        rotation=blend_rotations(before.rotation, after.rotation, weight),
        translation_m=before.translation_m + share * (after.translation_m - before.translation_m),
    )
