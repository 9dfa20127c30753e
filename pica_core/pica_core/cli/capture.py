"""`pica capture check` and `pica capture sheet`, and the options of both renders."""

import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console

from pica_core.capture.dataset.check import PIXEL_FRAMES, check_capture
from pica_core.capture.dataset.sheet import write_sheet
from pica_core.capture.stage.progress import rendering_bar
from pica_core.capture.stage.synth import Progress, RenderOptions
from pica_core.errors import CaptureError

SHOWN_PROBLEMS = 20
"""Problems that are shown; all are in the result."""
TEXELS_PER_PIXEL = 4
"""Side of the baked appearance against the longer side of the images: close-ups show a third of a
head, and its face covers half of the chart."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RenderArguments:
    """What both renders take: how many pictures, of what size, and where they go."""

    out: Path
    """Directory to fill; an interrupted render of the same subject and options is continued."""
    frames: int = 64
    """Frames in all."""
    cameras: int = 8
    """Cameras; the first five are the evaluation views front, left, right, up, down."""
    size: str = "512x384"
    """Image size, columns x rows, pixels."""
    texture_size: int = 256
    """Side of the average textures, texels."""
    seed: int = 0
    """Fixes performance, head motion and the errors of tracking and depth."""
    take: Path | None = None
    """Your own recording (a CSV of Live Link Face, or a take of `pica track`): a fifth of the
    frames are its moments that differ most."""

    def values(self) -> dict[str, Any]:
        """The arguments as `RenderOptions` names them."""
        found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", self.size)
        if found is None:
            raise CaptureError(f"size is {self.size!r}; columns x rows such as 512x384 is needed")
        names = ("frames", "cameras", "texture_size", "seed")
        width, height = (int(number) for number in found.groups())
        more = {"width": width, "height": height, "take": str(self.take or "")}
        return {name: getattr(self, name) for name in names} | more

    def render(
        self, console: Console, work: Callable[[Progress], dict[str, Any]]
    ) -> dict[str, Any]:
        """Show how far a render is, and what it made; returns its counts and how long it took."""
        started = time.monotonic()
        with rendering_bar(console, self.frames) as show:
            counts = work(show)
        seconds = time.monotonic() - started
        console.print(f"{counts['images']} images in {self.out}, {seconds:.1f} s")
        return {"out": str(self.out), "seconds": round(seconds, 3), **counts}


@dataclass(frozen=True, kw_only=True, slots=True)
class CheckOptions:
    """Options of `pica capture check`."""

    capture: Path = field(kw_only=False)
    """Capture directory: one of ours, or a Multiface directory as published."""
    pixel_frames: int = PIXEL_FRAMES
    """Frames whose images are decoded and compared with mesh and depth; 0 for all. Of the other
    frames every file is checked by its name, size and header."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SheetOptions:
    """Options of `pica capture sheet`."""

    capture: Path = field(kw_only=False)
    """Capture directory to look at."""
    out: Path
    """PNG to write."""


def baked_side(stage: RenderOptions) -> int:
    """Side of the baked appearance of a rig for images of this size, texels."""
    side = 1 << (TEXELS_PER_PIXEL * max(stage.width, stage.height) - 1).bit_length()
    return min(max(side, 512), 4096)


def check(options: CheckOptions) -> dict[str, Any]:
    """Find what is wrong with a capture."""
    result = check_capture(options.capture, options.pixel_frames)
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    for problem in result["problems"][:SHOWN_PROBLEMS]:
        console.print(f"{problem['where']}: {problem['what']}", markup=False)
    more = len(result["problems"]) - SHOWN_PROBLEMS
    if more > 0:
        console.print(f"... and {more} more; --json has them all")
    split = result["split"]
    console.print(
        f"{options.capture}: {'ok' if result['ok'] else 'not ok'}, {result['frames']} frames "
        f"({split['train']} for training, {split['test']} for testing), {result['cameras']} "
        f"cameras, {result['images']} images",
        markup=False,
    )
    return result


def sheet(options: SheetOptions) -> dict[str, Any]:
    """Draw a contact sheet of a capture."""
    result = write_sheet(options.capture, options.out)
    Console(stderr=True).print(f"contact sheet in {options.out}")
    return result
