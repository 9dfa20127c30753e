"""How a scheduler is set. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from pica_client.errors import OptionError
from pica_protocol.limits import MAX_LAYER


@dataclass(frozen=True, kw_only=True, slots=True)
class SchedulerOptions:
    """What the scheduler takes for good enough."""

    floor_mse: float = 1.0
    """Differences below this cannot be seen: nothing is bought for them (chosen: one step of 255 in
    every pixel)."""
    floor_ratio: float = 0.5
    """Nor can detail whose lack leaves less than this share of what pixels too few leave anyway
    (chosen: a head 256 pixels high is off by an MSE of 8 to 11 for want of samples, one of 64
    pixels by 30 to 50, and that flickers)."""
    stale_floor_mse: float = 0.25
    """Error of kept maps below which they are not made anew while things move (chosen: half a step;
    what is left is mended once it rests)."""
    settle_s: float = 0.2
    """Maps older than this are made anew for any difference."""
    max_age_s: float = 0.25
    """Maps whose error can be seen are not kept longer, whatever the budget; plus one frame."""
    margin: float = 0.7
    """A level's error must be below this share of what cannot be seen before a head goes down to
    it."""
    lower_after_s: float = 0.5
    """For so long a head must be small before it goes down a level."""
    retry_s: float = 0.5
    """First pause after the budget took a level away; doubles with each further time."""
    max_retry_s: float = 8.0
    """Longest such pause, and how long nothing must happen for the first to hold again."""
    wish_hold_s: float = 1.0
    """How long the stream of a head that left the screen is still wanted."""
    layer_px: tuple[float, ...] = (12.0, 32.0)
    """Heads lower than the first get layer 0, than the second layer 1, and so on; all others get
    everything (chosen: 7.5 and 15 faces a second where a face is a dozen and a few dozen pixels
    high)."""
    blur_px_s: float = 1500.0
    """Speed over the screen at which a head shows half of its detail (chosen: a display's frame of
    16 ms then smears it over 25 pixels)."""
    stale_weight: float = 0.25
    """What the error of a head counts that is faded because its stream fell silent."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("floor_mse", 0, 1e4),
            ("stale_floor_mse", 0, 1e4),
            ("settle_s", 0, 60),
            ("max_age_s", 0.001, 60),
            ("floor_ratio", 0, 10),
            ("margin", 0, 1),
            ("lower_after_s", 0, 60),
            ("retry_s", 0, 60),
            ("max_retry_s", self.retry_s, 600),
            ("wish_hold_s", 0, 600),
            ("blur_px_s", 1, 1e9),
            ("stale_weight", 0.001, 1),
        ):
            if not low <= getattr(self, name) <= high:
                raise OptionError(f"{name} is {getattr(self, name)}; {low} to {high} is allowed")
        if list(self.layer_px) != sorted(self.layer_px) or len(self.layer_px) > MAX_LAYER:
            raise OptionError(f"layer_px is {self.layer_px}; ascending, at most {MAX_LAYER}")
