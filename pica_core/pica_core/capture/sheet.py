"""A look at a capture on one page: views, depth, expressions, texture and camera plan."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from pica_core.capture import multiface
from pica_core.capture.dataset import Capture, CaptureFrame

ByteArray = npt.NDArray[np.uint8]

TILE = 240
"""Side of a tile, pixels."""
COLUMNS = 6
INK, PAPER = (232, 232, 236), (24, 26, 30)


def _fit(picture: Image.Image) -> Image.Image:
    tile = Image.new("RGB", (TILE, TILE), PAPER)
    small = picture.convert("RGB")
    small.thumbnail((TILE, TILE), Image.Resampling.LANCZOS)
    tile.paste(small, ((TILE - small.width) // 2, (TILE - small.height) // 2))
    return tile


def _depth_picture(depth_m: npt.NDArray[np.float32]) -> Image.Image:
    seen = depth_m > 0
    low, high = (
        (float(depth_m[seen].min()), float(depth_m[seen].max())) if seen.any() else (0.0, 1.0)
    )
    grey = np.where(seen, 255 - 215 * (depth_m - low) / max(high - low, 1e-6), 0)
    return Image.fromarray(grey.astype(np.uint8))


def _camera_plan(capture: Capture) -> Image.Image:
    """Cameras seen from above; the head is the circle, its nose points down the page."""
    picture = Image.new("RGB", (TILE, TILE), PAPER)
    draw = ImageDraw.Draw(picture)
    centres = np.array([camera.centre_m for camera in capture.cameras])
    scale = 0.42 * TILE / max(float(np.abs(centres[:, [0, 2]]).max()), 1e-6)
    middle = np.array([TILE / 2, TILE * 0.3])
    radius = 0.09 * scale
    draw.ellipse([*(middle - radius), *(middle + radius)], outline=INK)
    for camera, centre in zip(capture.cameras, centres, strict=True):
        at = middle + scale * centre[[0, 2]] * 0.9
        ahead = at + 14 * camera.rotation[2][[0, 2]]
        draw.line([*at, *ahead], fill=(240, 180, 80))
        draw.ellipse([*(at - 3), *(at + 3)], fill=(240, 180, 80))
        draw.text((at[0] + 4, at[1] + 2), camera.name, fill=INK)
    return picture


def _spread(frames: tuple[CaptureFrame, ...], capture: Capture, count: int) -> list[CaptureFrame]:
    """Frames that differ most from each other (farthest-point choice), the first one first."""
    values = np.stack([capture.arkit(frame) for frame in frames])
    chosen = [0]
    distance = np.linalg.norm(values - values[0], axis=1)
    while len(chosen) < min(count, len(frames)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(values - values[chosen[-1]], axis=1))
    return [frames[index] for index in chosen]


def write_sheet(directory: Path, out: Path) -> dict[str, Any]:
    """Draw the contact sheet of a capture.

    Raises:
        CaptureError: The capture cannot be read, or `out` cannot be written.
    """
    capture = Capture.open(directory)
    first = capture.frames[0]
    tiles: list[tuple[str, Image.Image]] = []
    for camera in capture.cameras[:5]:
        tiles.append((camera.name, Image.fromarray(capture.image(first, camera.name))))
    front = capture.cameras[0].name
    tiles.append((f"depth {front}", _depth_picture(capture.depth_m(first, front))))
    for frame in _spread(capture.frames, capture, 16):
        label = f"{frame.segment} {frame.name} {frame.split}"
        tiles.append((label, Image.fromarray(capture.image(frame, front))))
    tiles.append(("average texture", Image.fromarray(capture.average_texture(first))))
    tiles.append(("cameras from above", _camera_plan(capture)))
    rows = -(-len(tiles) // COLUMNS)
    page = Image.new("RGB", (COLUMNS * TILE, rows * TILE), PAPER)
    draw = ImageDraw.Draw(page)
    for index, (label, picture) in enumerate(tiles):
        at = (index % COLUMNS * TILE, index // COLUMNS * TILE)
        page.paste(_fit(picture), at)
        draw.text((at[0] + 6, at[1] + 4), label, fill=INK)
    data = io.BytesIO()
    page.save(data, "PNG")
    multiface.write_aside(out, data.getvalue())
    return {
        "out": str(out),
        "frames": len(capture.frames),
        "cameras": len(capture.cameras),
        "tiles": len(tiles),
    }
