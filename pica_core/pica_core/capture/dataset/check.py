"""Find what is wrong with a capture, by reading all of it as training does, and by its pictures.

Nothing here knows what a face looks like. Where the frames come with their 52 values, a ridge
regression says which vertices go with the jaw and with each lid; the depth of the front camera says
whether these are seen, and what lies between them.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image, ImageDraw

from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.dataset.files import SPLITS, CaptureFrame
from pica_core.errors import CaptureError
from pica_core.types import Array, Float64Array, Int64Array

LEAST_SHOWN = 0.03
"""Share of the mesh's vertices that lie in the picture of each camera at least."""
NUM_FRAMES: Final = 48
"""Frames that are looked at, evenly over the capture (chosen: as many as there are values)."""
RIDGE: Final = 0.02
CHART_PX: Final = 1024
MAX_OVERLAP: Final = 0.05
"""Share of a chart's area that may lie over another part of it (heads that were taken: 0.01)."""
LEAST_VALUE: Final = 0.3
"""A shape that never gets so strong is not judged."""
MOVES_MM: Final = {"jawOpen": 2.0, "eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0}
"""What a shape moves at full strength at least (heads that were taken: 4 to 9, and 3 to 5 mm)."""
MOVED_SHARE: Final = 0.5
"""Vertices that move at least so much of what the farthest do belong to a shape."""
DEEPEST_MM: Final = {"jawOpen": 40.0, "eyeBlinkLeft": 15.0, "eyeBlinkRight": 15.0}
"""How far behind a lower jaw teeth and tongue may lie, and an eye behind its lids (heads that were
taken: 15 and 4 mm; without teeth and tongue 59, without eyes 29)."""
PLACES: Final = {"jawOpen": "mouth", "eyeBlinkLeft": "left eye", "eyeBlinkRight": "right eye"}
HOLE_SHARE: Final = 0.02
"""Of a place's pixels may be deeper: edges are."""
LEAST_SEEN: Final = 0.3
"""Share of the moved vertices that the front camera sees."""
SURFACE_MM: Final = 10.0
"""A vertex is seen if the depth image has it so near."""


def check_capture(directory: Path) -> dict[str, Any]:
    """Read a capture directory whole.

    Returns:
        ``ok`` (bool), ``problems`` (a line each, which begins with the file), ``frames``,
        ``cameras``, ``images``, ``split`` (frames by split), ``missing`` (how many of the former
        three there should be, besides).

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
            if capture.has_masks:
                reads.append(partial(capture.mask, frame, camera.name))
        for read in reads:
            try:
                read()
            except CaptureError as error:
                problems.append(str(error))
    if not problems:
        problems += _judge_chart(capture)
    if not problems and capture.has_expressions:
        step = max(len(capture.frames) // NUM_FRAMES, 1)
        problems += _judge_face(capture, capture.frames[::step])
    images = sum(len(capture.cameras_of(frame)) for frame in capture.frames)
    counts = {"frames": len(capture.frames), "cameras": len(capture.cameras), "images": images}
    missing = {
        "frames": capture.num_listed - len(capture.frames),
        "cameras": len(capture.missing),
        "images": len(capture.frames) * len(capture.cameras) - images,
    }
    return {"ok": not problems, "problems": problems, **counts, "split": split, "missing": missing}


def _see(capture: Capture, frame: CaptureFrame) -> None:
    """Raise CaptureError for a camera that looks elsewhere."""
    vertices_m = capture.vertices_m(frame)
    for name in capture.cameras_of(frame):
        camera = capture.head_camera(frame, name)
        pixels, distance = camera.project(vertices_m)
        inside = (distance > 0) & (pixels >= 0).all(axis=1)
        seen = np.mean(inside & (pixels < [camera.width, camera.height]).all(axis=1))
        if seen < LEAST_SHOWN:
            raise CaptureError(
                f"{capture.calibration}: camera {name} sees {seen:.1%} of the mesh of "
                f"{frame.segment} {frame.name}"
            )


def _judge_chart(capture: Capture) -> list[str]:
    """Islands that leave the square or lie on each other: they would share their colours."""
    uv, faces = capture.topology.vertex_uv.astype(np.float64), capture.topology.faces
    outside = np.mean((np.abs(uv[faces] - 0.5) > 0.501).any(axis=(1, 2)))
    if outside:
        return [f"{capture.path}: {outside:.1%} of the triangles leave the square of the texture"]
    canvas = Image.new("1", (CHART_PX, CHART_PX))
    draw, area_px = ImageDraw.Draw(canvas), 0.0
    for corners in (CHART_PX * uv[faces]).tolist():
        (ax, ay), (bx, by), (cx, cy) = corners
        area_px += abs((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)) / 2
        draw.polygon([(ax, ay), (bx, by), (cx, cy)], fill=1)
    overlap = 1 - np.count_nonzero(np.asarray(canvas)) / max(area_px, 1.0)
    if overlap > MAX_OVERLAP:
        return [f"{capture.path}: {overlap:.0%} of the texture's islands lie on each other"]
    return []


def _judge_face(capture: Capture, frames: Sequence[CaptureFrame]) -> list[str]:
    """A jaw and lids that move, and are seen from the front with something behind them."""
    values = np.array([frame.arkit for frame in frames], np.float64)
    vertices_m = np.array([capture.vertices_m(frame) for frame in frames], np.float64)
    moved_m = _moved_by_shapes(values, vertices_m)
    problems = []
    for shape, least_mm in MOVES_MM.items():
        number = ARKIT_INDEX[shape]
        if np.ptp(values[:, number]) < LEAST_VALUE:
            continue
        lengths_mm = 1e3 * np.linalg.norm(moved_m[number], axis=1)
        if lengths_mm.max() < least_mm:
            found = f"{shape} moves nothing by more than {lengths_mm.max():.1f} mm"
            problems.append(f"{capture.path}: {found}; {least_mm:g} are expected")
            continue
        moved = np.flatnonzero(lengths_mm >= MOVED_SHARE * lengths_mm.max())
        # An open mouth, but open eyes: there something must be to be seen.
        strengths = values[:, number] if shape == "jawOpen" else -values[:, number]
        best = int(strengths.argmax())
        problems += _judge_place(capture, frames[best], shape, vertices_m[best][moved])
    return problems


def _moved_by_shapes(values: Float64Array, vertices_m: Float64Array) -> Float64Array:
    """How each shape moves each vertex at full strength. ``[52, V, 3]``"""
    rows = np.concatenate([np.ones((len(values), 1)), values], axis=1)
    pull = RIDGE * len(values) * np.eye(rows.shape[1])
    pull[0, 0] = 0.0
    sums = rows.T @ vertices_m.reshape(len(values), -1)
    return np.linalg.solve(rows.T @ rows + pull, sums)[1:].reshape(-1, *vertices_m.shape[1:])


def _judge_place(
    capture: Capture, frame: CaptureFrame, shape: str, moved_m: Float64Array
) -> list[str]:
    """What the front camera sees where a shape moves vertices ``[N, 3]``."""
    views = {name: capture.head_camera(frame, name) for name in capture.cameras_of(frame)}
    if not views or not capture.has_depth:
        return []
    name = max(views, key=lambda each: views[each].centre_m[2] / math.hypot(*views[each].centre_m))
    camera, depth_m = views[name], capture.depth_m(frame, name)
    pixels, distance_m = camera.project(moved_m)
    places = np.rint(pixels - 0.5).astype(np.int64)
    inside = (places >= 0).all(axis=1) & (places < [camera.width, camera.height]).all(axis=1)
    places, distance_m = places[inside], distance_m[inside]
    where = f"{capture.path}: {PLACES[shape]} of {frame.segment} {frame.name} from camera {name}"
    seen = np.abs(depth_m[places[:, 1], places[:, 0]] - distance_m) < SURFACE_MM * 1e-3
    if np.count_nonzero(seen) < LEAST_SEEN * len(moved_m):
        return [f"{where}: hidden; does the head look along its z axis?"]
    box = _box_of(depth_m, places[seen])
    limit_m = np.median(distance_m) + DEEPEST_MM[shape] * 1e-3
    holes = float(np.mean((box > limit_m) | (box == 0)))
    return [f"{where}: {holes:.0%} of it is empty"] if holes > HOLE_SHARE else []


def _box_of(image: Array, places: Int64Array) -> Array:
    """The part of an image around places ``[N, 2]``, columns and rows: the middle of it, for the
    outline of a cheek or a head is no hole."""
    low, high = np.percentile(places, (20, 80), axis=0).astype(int)
    box: Array = image[low[1] : high[1] + 1, low[0] : high[0] + 1]
    if not box.size:
        raise CaptureError("a place has no pixels")
    return box
