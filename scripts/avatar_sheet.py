"""Draw trained avatars beside what the cameras saw, on frames that training did not: a row each.

    python scripts/avatar_sheet.py docs/avatars.png work/amara/run work/tariq/run ...

Columns, true and drawn in pairs: the front, a side, the mouth where it is open widest, the eyes of
the first frame. Codes are what a live sender makes of ARKit values. Crops are the same pixels as
the front views have, enlarged.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.train.eval.model_evaluator import ModelEvaluator
from pica_core.train.eval.run import EvalLimits, build, open_run, prepare
from pica_core.train.rasterise import Rasteriser
from pica_core.types import ByteArray

TILE_PX = 224
FRAMES = 40
"""Held-out frames to choose from."""
MARGIN = 0.25
"""Of a crop's size, around the region."""

Box = tuple[int, int, int, int]
"""Left, top, right, bottom, pixels."""


def main() -> None:
    """Draw the sheet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("runs", type=Path, nargs="+")
    options = parser.parse_args()
    sheet = np.concatenate([np.concatenate(row_of(run), 1) for run in options.runs])
    Image.fromarray(sheet).quantize(256, dither=Image.Dither.NONE).save(options.out, optimize=True)


def row_of(folder: Path) -> list[ByteArray]:
    """The tiles of one run."""
    run = open_run(folder)
    limits = EvalLimits(frames=FRAMES, geometry_frames=0, near_frames=0)
    truth = prepare(run.capture, limits)
    data, model = truth.data, build(run, truth)
    front, side = data.images.evaluation_views[0], data.images.evaluation_views[2]
    jaw = data.arkit[truth.frames, ARKIT_NAMES.index("jawOpen")]
    first, widest = truth.frames[0], truth.frames[int(jaw.argmax())]
    with Rasteriser.of(data.meshes.topology(model.topology)) as rasteriser:
        evaluator = ModelEvaluator(data, model, rasteriser)

        def pair(frame: int, view: str, region: str = "") -> list[ByteArray]:
            seen, view_camera = data.images.image(frame, view), data.images.camera(frame, view)
            picture = evaluator.draw(evaluator.drive(frame), view_camera, samples=3)
            drawn = picture.on(np.full_like(seen, seen[0, 0]))
            box = (0, 0, view_camera.width, view_camera.height)
            if region:
                points = data.meshes.dense_m[frame][data.capture.topology.regions[region]]
                box = square_around(view_camera.project(points)[0])
            return [tile(seen, box), tile(drawn.round().astype(np.uint8), box)]

        return [
            *pair(widest, front),
            *pair(first, side),
            *pair(widest, front, "lips"),
            *pair(first, front, "eyeballs"),
        ]


def square_around(points_px: npt.NDArray[np.float64]) -> Box:
    """A square with some margin around points."""
    low, high = points_px.min(0), points_px.max(0)
    middle, half = (low + high) / 2, (high - low).max() * (0.5 + MARGIN)
    left, top = np.floor(middle - half).astype(int)
    right, bottom = np.ceil(middle + half).astype(int)
    return int(left), int(top), int(right), int(bottom)


def tile(picture: ByteArray, box: Box) -> ByteArray:
    """A part of a picture at the size of a tile."""
    part = Image.fromarray(picture).resize((TILE_PX, TILE_PX), Image.Resampling.BICUBIC, box=box)
    return np.asarray(part)


if __name__ == "__main__":
    main()
