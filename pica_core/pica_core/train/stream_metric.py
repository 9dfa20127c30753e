"""How much a change of the latent changes the picture: the metric that a latent stream is learned
with.

The trained model draws a face, then draws it again with the latent moved a little along one
direction after the other; the differences of the pictures are the columns of a Jacobian, and their
inner products, averaged over faces and views, the metric. Silhouettes count: what moves against the
background changes pixels too.
"""

import numpy as np
import torch
from torch import Tensor

from pica_core.capture.stage.dome import dome_cameras
from pica_core.capture.stage.expressions import stream_training_performances
from pica_core.codec.profile import StreamProfile
from pica_core.latent import LATENT_SHAPE, NUM_LATENT
from pica_core.train.eval.evaluate import ModelEvaluator, Picture
from pica_core.train.stream_learning import RenderMetric, learn_profile
from pica_core.types import Float64Array

BACKGROUND = 0.25
"""Colour around the head, 0 to 1: between skin and hair, so that both show against it."""
REACH = 0.5
"""How far a direction is followed, in standard deviations of the codes along it: as far as
differences between frames go."""
LEAST_REACH = 0.05
"""Below, pixels that change owner by chance drown what the direction does."""
FACES = 12
"""Faces that the metric is averaged over (chosen, as what follows)."""
DIRECTIONS = 64
"""Principal directions of the codes that it speaks of."""
VIEWS = ("front", "left")
"""Names of the stage's evaluation views that the pictures are drawn from."""
IMAGE_SIZE = 192
"""Rows and columns of the pictures."""


def make_stream_profile(painter: ModelEvaluator) -> StreamProfile:
    """Learn the stream of a trained avatar from codes as a live sender makes them."""
    with torch.no_grad():
        sequences = [
            painter.model.expression_encoder(torch.from_numpy(arkit)).permute(0, 2, 3, 1).numpy()
            for arkit in stream_training_performances()
        ]
        codes = np.concatenate(sequences).reshape(-1, NUM_LATENT).astype(np.float64)
        metric = _measure(painter, codes)
    return learn_profile(sequences, metric)


def _measure(painter: ModelEvaluator, codes: Float64Array) -> RenderMetric:
    by_name = {camera.name: camera for camera in dome_cameras(5, IMAGE_SIZE, IMAGE_SIZE)}
    plain = np.full((IMAGE_SIZE, IMAGE_SIZE, 3), BACKGROUND * 255, np.float32)

    def draw(code: Float64Array) -> list[Picture]:
        grid = torch.from_numpy(code.astype(np.float32)).view(1, *LATENT_SHAPE).permute(0, 3, 1, 2)
        vertices_m = painter.vertices_m(grid)
        return [painter.draw(grid, by_name[name], vertices_m=vertices_m) for name in VIEWS]

    def paint(code: Float64Array) -> Tensor:
        """Pictures of a latent ``[256]`` behind each other, 0-255."""
        pictures = [picture.on(plain).reshape(-1) for picture in draw(code)]
        return torch.from_numpy(np.concatenate(pictures))

    rng = np.random.default_rng(0)
    variance, axes = np.linalg.eigh(np.cov(codes.T, bias=True))
    largest = np.argsort(variance)[::-1][:DIRECTIONS]
    directions = axes.T[largest]
    reach = np.maximum(REACH * np.sqrt(np.maximum(variance[largest], 0)), LEAST_REACH)
    gram = np.zeros((len(directions), len(directions)))
    for code in codes[rng.choice(len(codes), FACES, replace=False)]:
        covered = sum(len(picture.pixels) for picture in draw(code))
        slopes = torch.stack(
            [
                (paint(code + step) - paint(code - step)) / (2 * length)
                for step, length in zip(reach[:, None] * directions, reach.tolist(), strict=True)
            ]
        )
        gram += (slopes @ slopes.T).numpy().astype(np.float64) / (3 * covered)
    return RenderMetric(directions, gram / FACES)
