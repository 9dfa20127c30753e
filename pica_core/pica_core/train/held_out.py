"""Held-out frames drawn while a run goes on: error and picture, without gradient or chance."""

import numpy as np

from pica_core.train.eval.metrics import mse
from pica_core.train.eval.model_evaluator import ModelEvaluator
from pica_core.train.objectives import Objectives
from pica_core.types import Image

WATCHED_FRAMES = 3
"""Held-out frames, evenly spaced."""


def draw_held_out(objectives: Objectives) -> tuple[float, Image]:
    """Draw held-out frames from the first evaluation view.

    Returns:
        Mean squared error, 0-255 over rasterised pixels, averaged over frames; and the pictures,
        one row a frame: predicted, captured. uint8 ``[WATCHED_FRAMES H, 2 W, 3]``.
    """
    data = objectives.data
    evaluator = ModelEvaluator(data, objectives.model, objectives.drawer.rasteriser)
    places = np.linspace(0, len(data.test_frames) - 1, min(WATCHED_FRAMES, len(data.test_frames)))
    errors, rows = [], []
    for frame in [data.test_frames[int(place)] for place in places]:
        views = (*data.images.evaluation_views_of(frame), *data.images.cameras_of(frame))
        view, captured = data.images.first_readable(frame, views)
        picture = evaluator.draw(evaluator.encode(frame), data.images.camera(frame, view))
        errors.append(mse(picture.colours, picture.within(captured)))
        predicted = picture.on(captured // 4)  # what the mesh does not cover: the capture, dark
        rows.append(np.concatenate([predicted.round().astype(np.uint8), captured], 1))
    return float(np.mean(errors)), np.concatenate(rows)
