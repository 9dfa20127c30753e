"""Find what is wrong with a capture, by reading all of it as training does."""

from collections.abc import Callable, Iterator
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
        for work in _works(capture, frame):
            try:
                work()
            except CaptureError as error:
                problems.append(str(error))
    images = sum(len(capture.cameras_of(frame)) for frame in capture.frames)
    counts = {"frames": len(capture.frames), "cameras": len(capture.cameras), "images": images}
    return {"ok": not problems, "problems": problems, **counts, "split": split}


def _works(capture: Capture, frame: CaptureFrame) -> Iterator[Callable[[], object]]:
    """Whatever is read of a frame."""
    yield partial(capture.average_texture, frame)
    if capture.has_truth:
        yield partial(capture.true_vertices_m, frame)
    for camera in capture.cameras:
        if capture.is_published and camera.name not in capture.cameras_of(frame):
            continue  # published captures miss frames of single cameras
        yield partial(capture.image, frame, camera.name)
        if capture.has_depth:
            yield partial(capture.depth_m, frame, camera.name)
        yield partial(_see, capture, frame, camera.name)


def _see(capture: Capture, frame: CaptureFrame, name: str) -> None:
    """Raise CaptureError for a camera that looks elsewhere."""
    camera = capture.head_camera(frame, name)
    pixels, distance = camera.project(capture.vertices_m(frame))
    inside = (distance > 0) & (pixels >= 0).all(axis=1)
    seen = np.mean(inside & (pixels < [camera.width, camera.height]).all(axis=1))
    if seen < LEAST_SEEN:
        raise CaptureError(
            f"{capture.path / multiface.KRT}: camera {name} sees {seen:.1%} of the mesh of "
            f"{frame.segment} {frame.name}"
        )
