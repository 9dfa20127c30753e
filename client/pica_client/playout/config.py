"""How a playout buffer is set. Pure."""

from dataclasses import dataclass

from pica_client.playout.motion import Distance
from pica_core.errors import check_ranges

CORRECTION_LIMIT = Distance(latent=10.0, turn_rad=3.0, move_m=0.5)
"""Fastest correction, per second: slower than faces move by themselves. The latents of the shipped
avatars move by up to 12 a second (root mean square, 99th percentile of performances; measured), a
head that is shaken turns by 5 (chosen)."""


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
    jitter_quantile: float = 0.95
    """Share of delays that are waited for; what is later is shown late. A burst is one delay."""
    window_s: float = 6.0
    """Time over which jitter is measured: so long the delay stays up after trouble (chosen: short
    enough that a call is fresh again soon, long enough to hold a share of 95 %)."""
    faster: float = 0.1
    """Share by which display time runs faster to catch up (chosen: speech 10 % faster looks
    natural). From ceiling to floor it takes 2 s."""
    slower: float = 0.25
    """Share by which it runs slower to fall back: more, for frames are late meanwhile (chosen)."""
    leap_s: float = 0.25
    """A display this far behind leaps, and the face goes over as after a gap."""
    max_frames: int = 64
    """Frames held; beyond it the oldest is dropped."""
    max_gap_s: float = 0.25
    """Longest time on the way between two frames; a longer gap is waited out first (chosen: 4 fps
    are still moved evenly)."""
    extrapolate_s: float = 1 / 15
    """Time after which a face without a next frame rests (measured on latents of the performances
    and of the range-of-motion recording: the error after gaps of 33 to 330 ms is least between 33
    and 130 ms)."""
    blend_s: float = 0.15
    """Time in which the face goes over to its path after it had to leave it (chosen: a blink)."""
    correction_limit: Distance = CORRECTION_LIMIT
    """Fastest such correction, per second; larger ones take longer than `blend_s`."""
    still_s: float = 2.5
    """How long a still face is believed without another word (chosen: two lost heartbeats)."""

    def __post_init__(self) -> None:
        if not 0 <= self.floor_s <= self.ceiling_s <= 10:
            raise ValueError(
                f"floor_s is {self.floor_s} and ceiling_s {self.ceiling_s}; "
                "0 <= floor_s <= ceiling_s <= 10 is needed"
            )
        if not 0 < self.jitter_quantile <= 1:
            raise ValueError(f"jitter_quantile is {self.jitter_quantile}; (0, 1] is allowed")
        small = dict.fromkeys(("floor_intervals", "faster", "extrapolate_s", "blend_s"), (0, 10))
        check_ranges(self, **small, window_s=(0.1, 60), slower=(0, 0.9), leap_s=(0, 60))
        check_ranges(self, max_frames=(2, 1000), max_gap_s=(0.001, 10), still_s=(0, 3600))
