"""A look at a capture on one page: one frame from all sides and in all kinds, and expressions.

What a capture does not have is left empty; what cannot be read says why in its tile. Pictures of a
published directory are made fit for looking at (`published.displayable`).
"""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageOps

from pica_core.capture.dataset import multiface
from pica_core.capture.dataset.dataset import Capture, CaptureFrame
from pica_core.capture.dataset.files import spread_evenly
from pica_core.capture.dataset.published import displayable
from pica_core.capture.triangles import edges, signed_areas
from pica_core.errors import CaptureError
from pica_core.types import FloatArray

TILE = 300
"""Side of a tile, pixels."""
LINE = 44
"""Characters of a message in a tile."""
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
Tile = tuple[str, Callable[[], Image.Image]]
"""A label, and what makes the picture."""


def write_sheet(directory: Path, out: Path) -> dict[str, Any]:
    """Draw the contact sheet of a capture."""
    capture = Capture.open(directory)
    grid = spread_evenly(capture.frames, COLUMNS * GRID_ROWS)
    shown = grid[min(1, len(grid) - 1)]
    rows = [_views(capture, shown), _kinds(capture, shown)]
    tiles: list[Tile] = []
    for frame in grid:
        camera = next(iter(capture.cameras_of(frame)), capture.cameras[0].name)
        label = f"{frame.segment} {frame.name} {frame.split}"
        tiles.append((label, lambda frame=frame, camera=camera: _face(capture, frame, camera)))  # type: ignore[misc]
    rows += [tiles[at : at + COLUMNS] for at in range(0, len(tiles), COLUMNS)]
    split = [f"{len(capture.frames_of(name))} {name}" for name in ("train", "test")]
    page = Image.new("RGB", (COLUMNS * TILE, len(rows) * TILE + 24), PAPER)
    ImageDraw.Draw(page).text(
        (6, 6),
        f"{directory.name}: {len(capture.frames)} frames ({', '.join(split)}; "
        f"{len(capture.left_out)} left out), {len(capture.cameras)} cameras of "
        f"{capture.cameras[0].width}x{capture.cameras[0].height}, "
        f"{capture.info.get('source', 'no source stated')}",
        fill=INK,
    )
    for number, row in enumerate(rows):
        for column, tile in enumerate(row):
            _draw_tile(page, (column * TILE, number * TILE + 24), tile)
    data = io.BytesIO()
    page.save(data, "PNG")
    multiface.write_aside(out, data.getvalue())
    return {
        "out": str(out),
        "frames": len(capture.frames),
        "cameras": len(capture.cameras),
        "tiles": sum(map(len, rows)),
    }


def _draw_tile(page: Image.Image, at: tuple[int, int], tile: Tile) -> None:
    """Draw a tile, or why it cannot be made."""
    (left, top), (label, make), draw = at, tile, ImageDraw.Draw(page)
    try:
        picture = make().convert("RGB")
    except CaptureError as error:
        text = str(error)
        lines = [text[k : k + LINE] for k in range(0, len(text), LINE)]
        draw.text((left + 8, top + 30), "\n".join(lines[:6]), fill=ACCENT)
    else:
        small = ImageOps.contain(picture, (TILE - 4, TILE - 4), Image.Resampling.LANCZOS)
        page.paste(small, (left + (TILE - small.width) // 2, top + (TILE - small.height) // 2))
    draw.text((left + 6, top + 4), label, fill=INK, stroke_width=2, stroke_fill=PAPER)


def _views(capture: Capture, frame: CaptureFrame) -> list[Tile]:
    """One frame from the evaluation views, or from the first cameras."""
    names = [camera.name for camera in capture.cameras]
    named = capture.info.get("evaluation_views")
    views = [name for name in named if name in names] if isinstance(named, list) else []
    return [
        (name, lambda name=name: _image(capture, frame, name))  # type: ignore[misc]
        for name in (views or names)[:COLUMNS]
    ]


def _kinds(capture: Capture, frame: CaptureFrame) -> list[Tile]:
    """What else is known of the frame, from its first view."""
    front = _views(capture, frame)[0][0]
    found: list[Tile] = [
        ("tracked mesh", lambda: _wire_picture(capture, frame, front)),
        ("average texture", lambda: Image.fromarray(capture.average_texture(frame))),
    ]
    if capture.has_depth:
        found.append(("depth", lambda: _depth_picture(capture.depth_m(frame, front))))
    if capture.has_masks:
        colours = len(PALETTE)
        found.append(
            ("mask", lambda: Image.fromarray(PALETTE[capture.mask(frame, front) % colours]))
        )
    return found


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
    left, top, right, bottom = (int(value) for value in (*(middle - half), *(middle + half)))
    return _image(capture, frame, camera_name).crop((left, top, right, bottom))


def _depth_picture(depth_m: FloatArray) -> Image.Image:
    """Near is light, unknown is black; the scale is that of the middle 98 per cent."""
    seen = depth_m > 0
    low, high = np.percentile(depth_m[seen], [1, 99]) if seen.any() else (0.0, 1.0)
    share = np.clip((depth_m - low) / max(float(high - low), 1e-6), 0, 1)
    return Image.fromarray(np.where(seen, 255 - 205 * share, 0).astype(np.uint8))


def _wire_picture(capture: Capture, frame: CaptureFrame, camera_name: str) -> Image.Image:
    """The tracked mesh's edges over an image."""
    camera = capture.head_camera(frame, camera_name)
    vertices, faces = capture.vertices_m(frame), capture.tracked_topology.faces
    picture = _image(capture, frame, camera_name)
    scale = 4 * TILE / max(picture.size)
    picture = ImageOps.contain(picture, (4 * TILE, 4 * TILE), Image.Resampling.BICUBIC)
    draw = ImageDraw.Draw(picture)
    place = camera.project(vertices)[0] * scale
    # Rows count downwards: what is counter-clockwise outside turns the other way in the image.
    facing = faces[signed_areas(place, faces) < 0]
    for ends in place[np.unique(np.sort(edges(facing), axis=1), axis=0)].reshape(-1, 4).tolist():
        draw.line(ends, fill=WIRE, width=1)
    return picture
