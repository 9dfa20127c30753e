"""A capture of a built-in head that is rendered in seconds."""

from __future__ import annotations

from pathlib import Path

from pica_core.capture.procedural.subject import StageOptions, render_capture


def render_small(folder: Path, *, frames: int = 6, cameras: int = 2, size: int = 64) -> Path:
    """Render square images of `size` pixels without measuring shadows."""
    options = StageOptions(
        frames=frames,
        cameras=cameras,
        width=size,
        height=size,
        texture_size=64,
        bake_size=256,
        self_shadow=False,
    )
    render_capture(options, folder)
    return folder
