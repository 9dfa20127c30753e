"""Find what is wrong with a capture, by reading all of it as training does."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pica_core.capture.dataset import multiface
from pica_core.capture.dataset.dataset import Capture, CaptureFrame
from pica_core.capture.dataset.files import SPLITS
from pica_core.errors import CaptureError

LEAST_SEEN = 0.03
"""Share of the mesh's vertices that lie in the picture of each camera at least."""


def check_capture(directory: Path) -> dict[str, Any]:
    """Read a capture directory whole.

    Returns:
        ``ok`` (bool), ``problems`` (a line each, which begins with the file), ``frames``,
        ``cameras``, ``images``, ``split`` (frames by split).

    Raises:
        CaptureError: It cannot be opened: the message names the file.
    """
    capture = Capture.open(directory)
    problems = list(capture.left_out)
    split = {name: len(capture.frames_of(name)) for name in SPLITS}
    problems += [
        f"{directory}: no frame is for {name}ing" for name, count in split.items() if not count
    ]
    for frame in capture.frames:
        reads: list[Callable[[], object]] = [partial(capture.average_texture, frame)]
        if capture.has_truth:
            reads.append(partial(capture.true_vertices_m, frame))
        reads.append(partial(_see, capture, frame))
        for camera in capture.cameras:
            if capture.is_published and camera.name not in capture.cameras_of(frame):
                continue  # published captures miss frames of single cameras
            reads.append(partial(capture.image, frame, camera.name))
            if capture.has_depth:
                reads.append(partial(capture.depth_m, frame, camera.name))
        for read in reads:
            try:
                read()
            except CaptureError as error:
                problems.append(str(error))
    images = sum(len(capture.cameras_of(frame)) for frame in capture.frames)
    counts = {"frames": len(capture.frames), "cameras": len(capture.cameras), "images": images}
    return {"ok": not problems, "problems": problems, **counts, "split": split}


def _see(capture: Capture, frame: CaptureFrame) -> None:
    """Raise CaptureError for a camera that looks elsewhere."""
    vertices_m = capture.vertices_m(frame)
    for name in capture.cameras_of(frame):
        camera = capture.head_camera(frame, name)
        pixels, distance = camera.project(vertices_m)
        inside = (distance > 0) & (pixels >= 0).all(axis=1)
        seen = np.mean(inside & (pixels < [camera.width, camera.height]).all(axis=1))
        if seen < LEAST_SEEN:
            raise CaptureError(
                f"{capture.path / multiface.KRT}: camera {name} sees {seen:.1%} of the mesh of "
                f"{frame.segment} {frame.name}"
            )
