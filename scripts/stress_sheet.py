"""Draw a trained model where no training was: codes far out, grazing views, the mouth from near.

    python scripts/stress_sheet.py runs/S1-full docs/results/stress.png

Rows: codes of held-out frames; codes 3 and 6 deviations out, in random directions; views that
graze the face; true and drawn pictures from 12 cm before the lips, where no camera stood.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from pica_core.camera import Camera, look_at
from pica_core.train.eval.model_evaluator import ModelEvaluator
from pica_core.train.eval.run import EvalLimits, build, open_run, prepare
from pica_core.train.rasterise import Rasteriser
from pica_core.types import ByteArray

TILE_PX = 192
COLUMNS = 6
SIGMAS = (3.0, 6.0)
GRAZING = ((86.0, 0.0), (-86.0, 0.0), (70.0, 40.0), (-70.0, -35.0), (0.0, 75.0), (0.0, -65.0))
"""Azimuth towards the subject's left and elevation, degrees."""
BACKGROUND = 40


def main() -> None:
    """Draw the sheet of a run."""
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    run = open_run(Path(sys.argv[1]))
    limits = EvalLimits(frames=COLUMNS, geometry_frames=0, near_frames=COLUMNS // 2)
    truth = prepare(run.capture, limits)
    data, model = truth.data, build(run, truth)
    with Rasteriser.of(data.meshes.topology(model.topology)) as rasteriser:
        evaluator = ModelEvaluator(data, model, rasteriser)
        codes = [evaluator.encode(frame) for frame in truth.frames]
        front = camera(0.0, 0.0)
        rows = [[draw(evaluator, code, front) for code in codes]]
        rows += [
            [draw(evaluator, code, front) for code in far_codes(evaluator, sigma)]
            for sigma in SIGMAS
        ]
        rows.append([draw(evaluator, codes[0], camera(*angles)) for angles in GRAZING])
        near = []
        pictures = {} if isinstance(truth.near, str) else truth.near
        for frame, (view, image) in pictures.items():
            near += [image, draw(evaluator, evaluator.encode(frame), view)]
        rows.append(near)
    tiles = [[np.asarray(Image.fromarray(tile).resize((TILE_PX, TILE_PX))) for tile in row]
             for row in rows if row]  # fmt: skip
    sheet = np.concatenate([np.concatenate(pad(row), 1) for row in tiles])
    Image.fromarray(sheet).quantize(256).save(sys.argv[2], optimize=True)


def camera(azimuth: float, elevation: float) -> Camera:
    """A metre away from the head."""
    a, e = np.radians([azimuth, elevation])
    target = np.array([0.0, -0.008, 0.02])
    away = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    return look_at(
        centre_m=target + away,
        target_m=target,
        vertical_fov=2 * np.arctan(0.5 * 0.32),
        width=2 * TILE_PX,
        height=2 * TILE_PX,
    )


def far_codes(evaluator: ModelEvaluator, sigma: float) -> list[Tensor]:
    """Codes `sigma` deviations of the training codes away from their mean, in every entry."""
    known = torch.cat([evaluator.encode(frame) for frame in evaluator.data.train_frames[::4]])
    mean, deviation = known.mean(0, keepdim=True), known.std(0, keepdim=True)
    noise = torch.randn((COLUMNS, *mean.shape[1:]), generator=torch.Generator().manual_seed(0))
    return list((mean + sigma * deviation * noise.sign())[:, None])


def draw(evaluator: ModelEvaluator, code: Tensor, view: Camera) -> ByteArray:
    """The picture of a code on a plain background, uint8 ``[H, W, 3]``."""
    plain = np.full((view.height, view.width, 3), BACKGROUND, np.uint8)
    return evaluator.draw(code, view).on(plain).round().astype(np.uint8)


def pad(row: list[ByteArray]) -> list[ByteArray]:
    """A row of `COLUMNS` tiles."""
    return row + [np.zeros_like(row[0])] * (COLUMNS - len(row))


if __name__ == "__main__":
    main()
