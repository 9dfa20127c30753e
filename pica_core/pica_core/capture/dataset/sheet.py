"""A look at a capture on one page: views, cameras, tracked mesh over an image, depth, expressions.

What a capture does not have is left empty; what cannot be read says why in its tile. Pictures of a
published directory are made fit for looking at (`published.displayable`).
"""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageOps

from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.capture.dataset import multiface
from pica_core.capture.dataset.dataset import Capture, CaptureFrame
from pica_core.capture.dataset.files import spread_evenly
from pica_core.capture.dataset.published import displayable
from pica_core.capture.triangles import edges, signed_areas
from pica_core.errors import CaptureError
from pica_core.types import Float64Array, FloatArray

TILE = 300
"""Side of a tile, pixels."""
COLUMNS = 6
GRID_ROWS = 4
"""Rows of the grid of expressions."""
INK, PAPER, ACCENT = (232, 232, 236), (24, 26, 30), (240, 180, 80)
WIRE = (70, 255, 150)
PALETTE = np.array(
    [(24, 26, 30), (214, 160, 130), (90, 160, 230), (245, 245, 235), (220, 90, 100), (110, 40, 60),
     (60, 90, 150), (120, 84, 50), (170, 200, 90), (200, 120, 210)], np.uint8
)  # fmt: skip
"""Colours of a mask's values, from 0; more values repeat them."""


class _Page:
    """Tiles on paper; a tile whose making fails says why."""

    def __init__(self, rows: int) -> None:
        self.picture = Image.new("RGB", (COLUMNS * TILE, rows * TILE + 24), PAPER)
        self._draw = ImageDraw.Draw(self.picture)
        self.tiles = 0

    def tile(
        self,
        column: int,
        row: int,
        label: str,
        make: Callable[..., Image.Image],
        *arguments: Any,
        span: int = 1,
    ) -> None:
        side = span * TILE
        at = (column * TILE, row * TILE + 24)
        try:
            picture = make(*arguments).convert("RGB")
        except CaptureError as error:
            self._draw.text((at[0] + 8, at[1] + 30), _wrapped(str(error)), fill=ACCENT)
        else:
            size = (side - 4, side - 4)
            small = ImageOps.contain(picture, size, Image.Resampling.LANCZOS)
            left, top = at[0] + (side - small.width) // 2, at[1] + (side - small.height) // 2
            self.picture.paste(small, (left, top))
        self._draw.text((at[0] + 6, at[1] + 4), label, fill=INK, stroke_width=2, stroke_fill=PAPER)
        self.tiles += 1

    def title(self, text: str) -> None:
        self._draw.text((6, 6), text, fill=INK)


def _wrapped(text: str, width: int = 44) -> str:
    return "\n".join(text[at : at + width] for at in range(0, min(len(text), 6 * width), width))


def _image(capture: Capture, frame: CaptureFrame, camera: str) -> Image.Image:
    image = capture.image(frame, camera)
    return Image.fromarray(displayable(image) if capture.is_published else image)


def _face(capture: Capture, frame: CaptureFrame, camera_name: str) -> Image.Image:
    """The part of an image around the face, or around the whole mesh where no face is named."""
    camera = capture.head_camera(frame, camera_name)
    pixels, _ = camera.project(capture.vertices_m(frame))
    face = capture.tracked_topology.region("face")
    pixels = pixels[face] if face.any() else pixels
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    middle, half = (low + high) / 2, max(0.62 * float((high - low).max()), 4.0)
    box = (*(middle - half).round().astype(int), *(middle + half).round().astype(int))
    return _image(capture, frame, camera_name).crop(tuple(int(v) for v in box))  # type: ignore[arg-type]


def _depth_picture(depth_m: FloatArray) -> Image.Image:
    """Near is light, unknown is black; the scale is that of the middle 98 per cent."""
    seen = depth_m > 0
    low, high = np.percentile(depth_m[seen], [1, 99]) if seen.any() else (0.0, 1.0)
    share = np.clip((depth_m - low) / max(float(high - low), 1e-6), 0, 1)
    return Image.fromarray(np.where(seen, 255 - 205 * share, 0).astype(np.uint8))


def _wire_picture(capture: Capture, frame: CaptureFrame, camera_name: str) -> Image.Image:
    """The tracked mesh's edges over the part of an image where the mesh is."""
    camera = capture.head_camera(frame, camera_name)
    vertices, faces = capture.vertices_m(frame), capture.tracked_topology.faces
    pixels, _ = camera.project(vertices)
    low = np.clip(np.percentile(pixels, 2, axis=0) - 8, 0, [camera.width - 2, camera.height - 2])
    high = np.clip(np.percentile(pixels, 98, axis=0) + 8, low + 2, [camera.width, camera.height])
    box = [int(value) for value in (*low, *high)]
    scale = 4 * TILE / max(box[2] - box[0], box[3] - box[1])
    size = (max(1, round((box[2] - box[0]) * scale)), max(1, round((box[3] - box[1]) * scale)))
    picture = _image(capture, frame, camera_name).crop((box[0], box[1], box[2], box[3]))
    picture = picture.resize(size, Image.Resampling.BICUBIC)
    draw = ImageDraw.Draw(picture)
    place = (pixels - box[:2]) * scale
    # Rows count downwards: what is counter-clockwise outside turns the other way in the image.
    facing = faces[signed_areas(place, faces) < 0]
    for ends in place[np.unique(np.sort(edges(facing), axis=1), axis=0)].reshape(-1, 4).tolist():
        draw.line(ends, fill=WIRE, width=1)
    return picture


def _camera_plan(capture: Capture, axes: tuple[int, int], signs: tuple[int, int]) -> Image.Image:
    """Cameras in a plane of the world; the circle is the head."""
    side = 2 * TILE
    picture = Image.new("RGB", (side, side), PAPER)
    draw = ImageDraw.Draw(picture)
    centres = np.array([camera.centre_m for camera in capture.cameras])[:, axes] * signs
    ahead = np.array([camera.rotation[2] for camera in capture.cameras])[:, axes] * signs
    points = np.concatenate([centres, [[0.0, 0.0]]])
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    scale = 0.78 * side / max(float(np.ptp(points, axis=0).max()), 0.3)

    def at(point: Float64Array) -> list[float]:
        return ((point - middle) * scale + side / 2).tolist()

    radius = 0.1 * scale
    x, y = at(np.zeros(2))
    draw.ellipse([x - radius, y - radius, x + radius, y + radius], outline=INK, width=2)
    named = len(capture.cameras) <= 12
    for camera, centre, way in zip(capture.cameras, centres, ahead, strict=True):
        x, y = at(centre)
        draw.line([x, y, *at(centre + 0.12 * way)], fill=ACCENT, width=2)
        draw.ellipse([x - 5, y - 5, x + 5, y + 5], fill=ACCENT)
        if named or camera.name in capture.info.get("evaluation_views", ()):
            draw.text((x + 8, y - 6), camera.name, fill=INK, font_size=18)
    return picture


def _spread(frames: tuple[CaptureFrame, ...], capture: Capture, count: int) -> list[CaptureFrame]:
    """Frames that differ most from each other (farthest-point choice), the first one first."""
    if not capture.has_expressions:
        return spread_evenly(frames, count)
    values = np.stack([capture.arkit(frame) for frame in frames])
    picked = [0]
    distance = np.linalg.norm(values - values[0], axis=1)
    while len(picked) < min(count, len(frames)):
        picked.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(values - values[picked[-1]], axis=1))
    return [frames[index] for index in picked]


def _telling(capture: Capture, frames: list[CaptureFrame]) -> CaptureFrame:
    """A frame with depth, of a face that does something with open eyes."""
    some = [f for f in frames[1:] if not capture.has_depth or capture.has_depth_of(f)]
    if not some or not capture.has_expressions:
        return (some or frames)[0]
    blink = [ARKIT_INDEX["eyeBlinkLeft"], ARKIT_INDEX["eyeBlinkRight"]]
    return min(some[:8], key=lambda frame: float(capture.arkit(frame)[blink].sum()))


def write_sheet(directory: Path, out: Path) -> dict[str, Any]:
    """Draw the contact sheet of a capture."""
    capture = Capture.open(directory)
    grid = _spread(capture.frames, capture, COLUMNS * GRID_ROWS)
    page = _Page(3 + -(-len(grid) // COLUMNS))
    _draw_stage(page, capture, _telling(capture, grid))
    for place, frame in enumerate(grid):
        camera = next(iter(capture.cameras_of(frame)), capture.cameras[0].name)
        row, column = divmod(place, COLUMNS)
        label = f"{frame.segment} {frame.name} {frame.split}"
        page.tile(column, 3 + row, label, _face, capture, frame, camera)
    split = [f"{len(capture.frames_of(name))} {name}" for name in ("train", "test")]
    page.title(
        f"{directory.name}: {len(capture.frames)} frames ({', '.join(split)}; "
        f"{len(capture.left_out)} left out), {len(capture.cameras)} cameras of "
        f"{capture.cameras[0].width}x{capture.cameras[0].height}, "
        f"{capture.info.get('source', 'no source stated')}"
    )
    data = io.BytesIO()
    page.picture.save(data, "PNG")
    multiface.write_aside(out, data.getvalue())
    return {
        "out": str(out),
        "frames": len(capture.frames),
        "cameras": len(capture.cameras),
        "tiles": page.tiles,
    }


def _draw_stage(page: _Page, capture: Capture, frame: CaptureFrame) -> None:
    """The first three rows: one frame from all sides, and the cameras."""
    named = capture.info.get("evaluation_views")
    names = [camera.name for camera in capture.cameras]
    views = [name for name in named if name in names] if isinstance(named, list) else []
    views = (views or names)[: COLUMNS - 1]
    for column, name in enumerate(views):
        page.tile(column, 0, name, _image, capture, frame, name)
    front = views[0]
    page.tile(5, 0, "cameras from above", _camera_plan, capture, (0, 2), (1, 1))
    page.tile(0, 1, "tracked mesh", _wire_picture, capture, frame, front, span=2)
    page.tile(
        2, 1, "average texture", lambda: Image.fromarray(capture.average_texture(frame)), span=2
    )
    if capture.has_depth_of(frame):
        page.tile(4, 1, "depth", lambda: _depth_picture(capture.depth_m(frame, front)))
    if capture.has_truth:
        page.tile(5, 1, "exact depth", lambda: _depth_picture(capture.true_depth_m(frame, front)))
    if capture.has_masks:
        page.tile(
            4,
            2,
            "mask",
            lambda: Image.fromarray(PALETTE[capture.mask(frame, front) % len(PALETTE)]),
        )
    page.tile(5, 2, "cameras from the side", _camera_plan, capture, (2, 1), (1, -1))
