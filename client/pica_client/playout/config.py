"""How a playout buffer is set. Pure."""

from dataclasses import dataclass

from pica_core.errors import check_ranges


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
    leap_s: float = 0.25
    """A display this far behind leaps, and the face goes over as after a gap."""
    extrapolate_s: float = 1 / 15
    """Time after which a face without a next frame rests (measured on latents of the performances
    and of the range-of-motion recording: the error after gaps of 33 to 330 ms is least between 33
    and 130 ms)."""
    blend_s: float = 0.15
    """Time in which the face goes over to its path after it had to leave it (chosen: a blink)."""

    def __post_init__(self) -> None:
        small = dict.fromkeys(("floor_intervals", "extrapolate_s", "blend_s"), (0, 10))
        check_ranges(self, ceiling_s=(0, 10), **small, leap_s=(0, 60))
        check_ranges(self, floor_s=(0, self.ceiling_s))
