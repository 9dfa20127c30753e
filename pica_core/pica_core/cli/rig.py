"""`pica capture rig`."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from pica_core.capture.rig.subject import RigSubject
from pica_core.capture.stage.progress import rendering_bar
from pica_core.capture.stage.synth import RenderOptions, render_subject
from pica_core.errors import CaptureError

TEXELS_PER_PIXEL = 4
"""Side of the baked appearance against the longer side of the images: close-ups show a third of a
head, and its face covers half of the chart."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RigOptions:
    """Render a head with blendshapes into a capture directory."""

    rig: Path
    """A .glb file with morph targets, or a folder of OBJ files of one topology."""
    out: Path
    """Directory to fill; an interrupted render of the same rig and options is continued."""
    map: Path | None = None
    """JSON file of source names to ARKit names (or null), which goes before the rules."""
    albedo: tuple[str, ...] = ()
    """Base colour images: FILE for the material with most triangles, or MATERIAL=FILE. What has no
    image is painted."""
    frames: int = 64
    """Frames in all."""
    cameras: int = 8
    """Cameras; the first five are the evaluation views front, left, right, up, down."""
    size: str = "512x384"
    """Image size, columns x rows, pixels."""
    texture_size: int = 256
    """Side of the average textures, texels."""
    seed: int = 0
    """Fixes the performance."""

    def __post_init__(self) -> None:
        if re.fullmatch(r"\d{1,5}x\d{1,5}", self.size) is None:
            raise CaptureError(f"size is {self.size!r}; columns x rows such as 512x384 is needed")


def rig(options: RigOptions) -> dict[str, Any]:
    """Run `pica capture rig`."""
    width, height = (int(number) for number in options.size.split("x"))
    stage = RenderOptions(
        frames=options.frames,
        cameras=options.cameras,
        width=width,
        height=height,
        texture_size=options.texture_size,
        seed=options.seed,
    )
    started = time.monotonic()
    console = Console(stderr=True)
    about: dict[str, Any] = {}

    def make() -> RigSubject:
        side = 2 ** int(np.ceil(np.log2(TEXELS_PER_PIXEL * max(width, height))))
        subject = RigSubject(
            options.rig, options.map, options.albedo, bake_size=min(max(side, 512), 4096)
        )
        about.update(subject.describe()["rig"])
        _tell(console, about)
        return subject

    with rendering_bar(console, options.frames) as show:
        counts = render_subject(make, stage, options.out, show)
    seconds = time.monotonic() - started
    console.print(f"{counts['images']} images in {options.out}, {seconds:.1f} s")
    return {"out": str(options.out), "seconds": round(seconds, 3), **counts, **about}


def _tell(console: Console, about: dict[str, Any]) -> None:
    """What was understood, for somebody who wonders why their head looks odd."""
    console.print(
        f"{len(about['mapped'])} shapes mapped, {len(about['missing'])} ARKit shapes missing, "
        f"{len(about['ignored'])} shapes ignored; unit {about['unit']}, axes {about['axes']}"
    )
    for name, text in (
        ("missing", "missing"),
        ("ignored", "ignored"),
        ("left_out_materials", "materials left out"),
        ("guessed", "assumed"),
    ):
        if about[name]:
            console.print(f"{text}: {', '.join(about[name])}", highlight=False)
