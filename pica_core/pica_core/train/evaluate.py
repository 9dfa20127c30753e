"""Held-out error: the paper's protocol at the size of one table row per view.

MSE is on 0-255 values over rasterised pixels of the decoded mesh, on frames that training never
saw, as in the paper's tables. "encoder" rows use the model's own encoder, "driver" rows the
expression encoder, which is what a live sender runs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from pica_core.model.decoders import sample_map
from pica_core.train.data import view_direction
from pica_core.train.loop import Trainer


def evaluate(trainer: Trainer, *, max_frames: int = 25) -> list[dict[str, Any]]:
    """Evaluate on evenly spaced test frames, from the capture's evaluation views.

    Returns:
        Rows of {source, view, mse, mse_low, mse_high, vertex_error_mm, frames}: mean squared error
        with its 95 % interval over frames (normal approximation), and mean vertex distance.
    """
    data = trainer.data
    step = max(1, -(-len(data.test_frames) // max_frames))
    frames = data.test_frames[::step]
    errors: dict[tuple[str, str], list[float]] = {}
    distances: dict[str, list[float]] = {"encoder": [], "driver": []}
    with torch.no_grad():
        for frame in frames:
            codes = {
                "encoder": trainer.encode([frame])[0],
                "driver": trainer.model.expression_encoder(data.arkit[[frame]]),
            }
            for source, latent in codes.items():
                vertices_m = sample_map(trainer.model.decode_geometry(latent), data.vertex_uv)
                offset = vertices_m - data.meshes([frame])
                distances[source].append(float(offset.norm(dim=2).mean()) * 1000)
                for view in data.evaluation_views:
                    mse = _image_mse(trainer, latent, vertices_m, frame, view)
                    errors.setdefault((source, view), []).append(mse)
    rows = []
    for (source, view), values in errors.items():
        mean = float(np.mean(values))
        half = 1.96 * float(np.std(values)) / np.sqrt(len(values))
        rows.append(
            {
                "source": source,
                "view": view,
                "mse": mean,
                "mse_low": mean - half,
                "mse_high": mean + half,
                "vertex_error_mm": float(np.mean(distances[source])),
                "frames": len(values),
            }
        )
    return rows


def mean_mse(rows: list[dict[str, Any]], source: str = "encoder") -> float:
    """The mean over views of one source's MSE."""
    return float(np.mean([row["mse"] for row in rows if row["source"] == source]))


def _image_mse(
    trainer: Trainer, latent: torch.Tensor, vertices_m: torch.Tensor, frame: int, view: str
) -> float:
    colours, observed = _shade_all(trainer, latent, vertices_m, frame, view)
    return float((255 * (colours.clamp(0, 1) - observed)).square().mean())


def _shade_all(
    trainer: Trainer, latent: torch.Tensor, vertices_m: torch.Tensor, frame: int, view: str
) -> tuple[torch.Tensor, torch.Tensor]:
    data = trainer.data
    surface, observed = trainer.surface(
        vertices_m, [frame], [view], np.random.default_rng(0), every_pixel=True
    )
    direction = torch.from_numpy(view_direction(data.camera(frame, view)))[None]
    codes = trainer.model.decode_expression(latent, direction)
    return trainer.model.shade(codes, surface), observed
