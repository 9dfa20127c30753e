"""How a call is shown, as its user or a program wants it."""

from dataclasses import dataclass, field
from pathlib import Path

from pica_client.errors import check_ranges
from pica_client.render.views import MAX_EYE_DISTANCE_M
from pica_client.schedule.scheduler import SchedulerOptions
from pica_client.ui.controls import ControlState

BUDGET_SHARE = 0.8
"""Part of the time between two frames: the rest is for texts, the window system and recording."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewerOptions:
    """How a call is shown."""

    size: tuple[int, int] = (960, 540)
    """Columns and rows of the image or window, pixels."""
    headless: bool = False
    """Draw without a window."""
    record: Path | None = None
    """MP4 file to record into from the start."""
    keep_in: Path | None = None
    """Folder for the pictures and recordings that the user asks for meanwhile; None is the system's
    for each of them."""
    max_fps: float = 30.0
    """Frames are drawn no more often than this; in a window the display limits too."""
    frame_budget_ms: float = 0.0
    """What decoding and drawing a frame may take before detail is given up, milliseconds; 0 is
    `BUDGET_SHARE` of the time between two frames."""
    scheduler: SchedulerOptions = field(default_factory=SchedulerOptions)
    eye_distance_m: float = 0.0
    """Above 0 the picture is side by side for two eyes so far apart, metres."""
    at_first: ControlState = field(default_factory=ControlState)
    """What the user wants at first; what becomes of face and voice is the viewer's to say."""

    def __post_init__(self) -> None:
        check_ranges(self, max_fps=(1, 1000), frame_budget_ms=(0, 10_000))
        check_ranges(self, eye_distance_m=(0, MAX_EYE_DISTANCE_M))
