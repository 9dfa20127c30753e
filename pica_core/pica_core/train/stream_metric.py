"""How much a change of the latent changes the picture: the metric that a latent stream is learned
with.

The trained model draws a face, then draws it again with the latent moved a little along one
direction after the other; the differences of the pictures are the columns of a Jacobian, and their
inner products, averaged over faces and views, the metric. Silhouettes count: what moves against the
background changes pixels too.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from pica_core.avatar.spec import LATENT_SHAPE, NUM_LATENT
from pica_core.camera import Camera
from pica_core.capture.stage.dome import dome_cameras
from pica_core.capture.stage.stream_training_faces import stream_training_performances
from pica_core.codec.learning import LearningConfig, RenderMetric, learn_profile
from pica_core.codec.profile import StreamProfile
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.model.decoders import sample_map
from pica_core.model.interface import Surface
from pica_core.train.data.images import view_direction
from pica_core.train.rasterise import Rasteriser, interpolate
from pica_core.types import Float64Array

BACKGROUND = 0.25
"""Colour around the head, 0 to 1: between skin and hair, so that both show against it."""
REACH = 0.5
"""How far a direction is followed, in standard deviations of the codes along it: as far as
differences between frames go."""
LEAST_REACH = 0.05
"""Below, pixels that change owner by chance drown what the direction does."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamOptions:
    """How a stream's tables are made at export."""

    faces: int = 12
    """Faces that the metric is averaged over."""
    directions: int = 64
    """Principal directions of the codes that it speaks of."""
    views: tuple[str, ...] = ("front", "left")
    """Of the stage's evaluation views."""
    image_size: int = 192
    """Rows and columns of the pictures."""
    practice_rounds: int = 36
    """Performances of each kind to learn from."""
    learning: LearningConfig = field(default_factory=LearningConfig)
    seed: int = 0


def make_stream_profile(
    model: PixelCodecAvatar,
    rasteriser: Rasteriser,
    faces: Tensor,
    vertex_uv: Tensor,
    options: StreamOptions | None = None,
) -> StreamProfile:
    """Learn the stream of a trained avatar from codes as a live sender makes them.

    Args:
        model: Trained, its expression encoder included.
        rasteriser: For the avatar's topology.
        faces: int64 ``[F, 3]``.
        vertex_uv: float32 ``[V, 2]``.
        options: See `StreamOptions`.
    """
    options = options or StreamOptions()
    with torch.no_grad():
        sequences = [
            model.expression_encoder(torch.from_numpy(arkit)).permute(0, 2, 3, 1).numpy()
            for arkit in stream_training_performances(options.practice_rounds, seed=options.seed)
        ]
        codes = np.concatenate(sequences).reshape(-1, NUM_LATENT).astype(np.float64)
        painter = _Painter(model, rasteriser, faces, vertex_uv, options)
        metric = _measure(painter, codes, options)
    return learn_profile(sequences, metric, options.learning)


class _Painter:
    """Draws a latent from every view, as one long vector of 0-255 values."""

    def __init__(
        self,
        model: PixelCodecAvatar,
        rasteriser: Rasteriser,
        faces: Tensor,
        vertex_uv: Tensor,
        options: StreamOptions,
    ) -> None:
        self._model, self._rasteriser = model, rasteriser
        self._faces, self._vertex_uv = faces, vertex_uv
        size = options.image_size
        by_name = {camera.name: camera for camera in dome_cameras(5, size, size)}
        self._cameras = [by_name[name] for name in options.views]

    def paint(self, code: Float64Array) -> tuple[Tensor, int]:
        """Pictures of a latent ``[256]`` behind each other, and how many pixels the head covers."""
        grid = torch.from_numpy(code.astype(np.float32)).view(1, *LATENT_SHAPE).permute(0, 3, 1, 2)
        vertices_m = sample_map(self._model.decode_geometry(grid), self._vertex_uv)[0]
        painted = [self._paint_view(grid, vertices_m, camera) for camera in self._cameras]
        return torch.cat([picture for picture, _ in painted]), sum(count for _, count in painted)

    def _paint_view(self, grid: Tensor, vertices_m: Tensor, camera: Camera) -> tuple[Tensor, int]:
        ids = self._rasteriser.triangle_ids(vertices_m.numpy(), camera)
        covered = np.flatnonzero(ids.reshape(-1) >= 0)
        uv, xyz_m, _ = interpolate(vertices_m, self._vertex_uv, self._faces, camera, ids, covered)
        direction = torch.from_numpy(view_direction(camera))[None]
        image = torch.zeros(len(covered), dtype=torch.int64)
        colours = self._model.shade(
            self._model.decode_expression(grid, direction), Surface(image, uv, xyz_m)
        )
        picture = torch.full((ids.size, 3), BACKGROUND)
        picture[torch.from_numpy(covered)] = colours.clamp(0, 1)
        return picture.reshape(-1) * 255, len(covered)


def _measure(painter: _Painter, codes: Float64Array, options: StreamOptions) -> RenderMetric:
    rng = np.random.default_rng(options.seed)
    _, spread, directions = np.linalg.svd(codes - codes.mean(axis=0), full_matrices=False)
    directions = directions[: options.directions]
    reach = np.maximum(REACH * spread[: len(directions)] / np.sqrt(len(codes)), LEAST_REACH)
    gram = np.zeros((len(directions), len(directions)))
    for code in codes[rng.choice(len(codes), options.faces, replace=False)]:
        covered = painter.paint(code)[1]
        slopes = torch.stack(
            [
                (painter.paint(code + step)[0] - painter.paint(code - step)[0]) / (2 * length)
                for step, length in zip(reach[:, None] * directions, reach.tolist(), strict=True)
            ]
        )
        gram += (slopes @ slopes.T).numpy().astype(np.float64) / (3 * covered)
    return RenderMetric(directions, gram / options.faces)
