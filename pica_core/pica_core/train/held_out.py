"""Held-out frames drawn while a run goes on: error and picture, without gradient or chance."""

import numpy as np
import torch

from pica_core.train.data.images import view_direction
from pica_core.train.objectives import Objectives
from pica_core.types import Image

WATCHED_FRAMES = 3
"""Held-out frames, evenly spaced."""


@torch.no_grad()
def draw_held_out(objectives: Objectives) -> tuple[float, Image]:
    """Draw held-out frames from the first evaluation view.

    Returns:
        Mean squared error, 0-255 over rasterised pixels, averaged over frames; and the pictures,
        one row a frame: predicted, captured. uint8 ``[WATCHED_FRAMES H, 2 W, 3]``.
    """
    data, model, drawer = objectives.data, objectives.model, objectives.drawer
    places = np.linspace(0, len(data.test_frames) - 1, min(WATCHED_FRAMES, len(data.test_frames)))
    errors, rows = [], []
    for frame in [data.test_frames[int(place)] for place in places]:
        cameras = data.images.cameras_of(frame)
        view = next((name for name in data.images.evaluation_views if name in cameras), cameras[0])
        camera = data.images.camera(frame, view)
        latent, _ = objectives.encode([frame])
        mesh = model.decode_mesh(latent)
        direction = torch.from_numpy(view_direction(camera))[None].to(objectives.device)
        drawer.rasterise(mesh.vertices_m, [camera])
        drawn = drawer.draw(
            mesh.vertices_m,
            [np.random.default_rng(0)],
            pixels_per_image=0,
            normals=False,
            detach_xyz=True,
        )
        observed = objectives.colours([(frame, view)], drawn.pixels)
        colours = model.shade(model.appearance(latent, direction), drawn.surface).clamp(0, 1)
        errors.append(float((255 * (colours - observed)).square().mean()))
        captured = data.images.image(frame, view)
        predicted = captured.reshape(-1, 3) // 4  # what the mesh does not cover: the capture, dark
        shades = (255 * colours).round().to(torch.uint8).cpu().numpy()
        predicted[drawn.pixels.pixel] = shades
        rows.append(np.concatenate([predicted.reshape(captured.shape), captured], 1))
    return float(np.mean(errors)), np.concatenate(rows)
