"""Trainings that should go wrong, and by how much they do: each is a run with one part spoilt.

What a row shows is what this model does on one small capture in few steps; it says nothing of other
data. `run_failures` trains them all alike and gives rows to compare with the first, which nothing
spoils.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pica_core.camera import Camera
from pica_core.errors import TrainingDivergedError
from pica_core.train.config import PAPER_LOSSES, TrainConfig
from pica_core.train.data.training import TrainingData
from pica_core.train.held_out import draw_held_out
from pica_core.train.loop import open_trainer
from pica_core.train.monitor import METRICS
from pica_core.types import FloatArray

OUTLIER_RATIO = 0.3
"""Part of the known depths that are made wrong."""
OUTLIER_M = 0.05
"""How much is added to a wrong depth, metres."""
CAMERA_TURN = 0.02
"""How far the wrong camera is turned, radians: 20 mm at 1 m."""
SIGMAS = (3.0, 6.0)
"""Codes that far out are decoded, in deviations of the training frames' codes."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Failure:
    """What is spoilt."""

    model: Mapping[str, float] = field(default_factory=dict)
    """Options of the model that differ."""
    losses: Mapping[str, float] = field(default_factory=dict)
    """Weights of losses that differ."""
    detach_pixel_xyz: bool = True
    """Whether the gradient through the xyz input is stopped, as in `TrainConfig`."""
    depth_outliers: bool = False
    """Depth is wrong at `OUTLIER_RATIO` of the pixels."""
    wrong_camera: bool = False
    """One training camera stands where its calibration does not say."""

    def config(self, config: TrainConfig) -> TrainConfig:
        """The options with what is spoilt in them."""
        changed = config.changed(model=self.model, losses=self.losses)
        return replace(changed, detach_pixel_xyz=self.detach_pixel_xyz)


FAILURES: dict[str, Failure] = {
    "nothing": Failure(),
    "siren_frequency_60": Failure(model={"first_frequency": 60.0}),
    "kl_off": Failure(losses={"kl": 0.0}),
    "kl_1000_times": Failure(losses={"kl": 1.0}),
    "no_mesh_loss": Failure(losses={"mesh": 0.0}),
    "no_smoothness": Failure(losses={"smooth": 0.0}),
    "both_gradient_paths": Failure(detach_pixel_xyz=False),
    "depth_outliers": Failure(depth_outliers=True),
    "wrong_camera": Failure(wrong_camera=True),
}


@contextmanager
def spoil(data: TrainingData, failure: Failure) -> Iterator[None]:
    """Let `data` give what `failure` says, for the time of a block; the files stay as they are."""
    images = data.images
    true_depth_m, true_camera = images.depth_m, images.camera

    def depth_m(frame: int, camera: str) -> FloatArray:
        """Depth with outliers, the same ones each time."""
        depth_m = true_depth_m(frame, camera)
        rng = np.random.default_rng([frame, *camera.encode()])
        wrong = (depth_m > 0) & (rng.random(depth_m.shape) < OUTLIER_RATIO)
        return np.where(wrong, depth_m + np.float32(OUTLIER_M), depth_m)

    def camera(frame: int, name: str) -> Camera:
        """The camera; one of them turned about its x axis."""
        camera = true_camera(frame, name)
        if name != images.camera_names[-1]:
            return camera
        sine, cosine = np.sin(CAMERA_TURN), np.cos(CAMERA_TURN)
        turn = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
        rotation, translation = turn @ camera.rotation, turn @ camera.translation_m
        return replace(camera, rotation=rotation, translation_m=translation)

    images.depth_m = depth_m if failure.depth_outliers else true_depth_m  # type: ignore[method-assign]
    images.camera = camera if failure.wrong_camera else true_camera  # type: ignore[method-assign]
    try:
        yield
    finally:
        del images.depth_m, images.camera


def run_failures(
    data: TrainingData,
    config: TrainConfig,
    folder: Path,
    names: Iterable[str] = tuple(FAILURES),
    seeds: Iterable[int] = (0,),
) -> Iterator[dict[str, Any]]:
    """Train one run for each failure and seed.

    Args:
        data: A capture with depth and exact meshes.
        config: Of all runs; the paper's six losses take the place of its losses.
        folder: Runs go into folders of their own.
        names: Keys of `FAILURES`.
        seeds: Of weights and batches.

    Yields:
        Rows of {failure, seed, curve, steps, diverged, mse, vertex_error_mm, code_deviation,
        rollbacks, reach_3_sigma_mm, reach_6_sigma_mm}: looks at held-out frames ({step, seconds,
        mse} each), held-out error, deviation of the training codes' values (KL pulls it to 1), and
        how far the face goes at codes far out; None after divergence.
    """
    for name in names:
        for seed in seeds:
            whole = replace(FAILURES[name].config(replace(config, losses=PAPER_LOSSES)), seed=seed)
            yield {
                "failure": name,
                "seed": seed,
                **_run(data, whole, folder / f"{name}-{seed}", FAILURES[name]),
            }


def _run(data: TrainingData, config: TrainConfig, run: Path, failure: Failure) -> dict[str, Any]:
    row: dict[str, Any] = {"diverged": False, "mse": None, "vertex_error_mm": None}
    with open_trainer(data, config, run) as trainer:
        try:
            with spoil(data, failure):
                trainer.run()
        except TrainingDivergedError:
            row["diverged"] = True
        row["curve"] = curve(run)
        row |= {"steps": trainer.step, "rollbacks": trainer.rollbacks}
        if row["diverged"]:
            return row
        row["mse"], _ = draw_held_out(trainer.objectives)
        with torch.no_grad():
            frames = data.test_frames
            latent, _ = trainer.objectives.encode(frames)
            offset = trainer.model.vertices(latent) - data.meshes.dense(frames)
            row["vertex_error_mm"] = float(offset.norm(dim=2).mean()) * 1000
            codes, _ = trainer.objectives.encode(data.train_frames)
            row["code_deviation"] = float(codes.std())
        for sigma in SIGMAS:
            reach_mm = far_codes_reach_mm(trainer.model.vertices, codes, sigma)
            row[f"reach_{sigma:g}_sigma_mm"] = reach_mm
    return row


def curve(run_dir: Path) -> list[dict[str, Any]]:
    """What the looks at held-out frames found, {step, seconds, mse}, oldest first."""
    rows = [json.loads(line) for line in (run_dir / METRICS).read_text().splitlines()]
    return [
        {key: row[key] for key in ("step", "seconds", "mse")}
        for row in rows
        if row["kind"] == "held_out"
    ]


@torch.no_grad()
def far_codes_reach_mm(
    decode: Callable[[torch.Tensor], torch.Tensor], codes: torch.Tensor, sigma: float
) -> float:
    """How far vertices go at codes far out, against the mean code's mesh.

    Args:
        decode: Latents ``[N, 4, 8, 8]`` to vertices in metres ``[N, V, 3]``.
        codes: Codes of real frames, ``[T, 4, 8, 8]``.
        sigma: How far out, in deviations of each value; 16 random directions.

    Returns:
        The largest distance, millimetres; NaN if anything is not finite.
    """
    mean, deviation = codes.mean(0, keepdim=True), codes.std(0, keepdim=True)
    noise = torch.randn((16, *mean.shape[1:]), generator=torch.Generator().manual_seed(0))
    sign = noise.sign().to(mean)
    offset = decode(mean + sigma * deviation * sign) - decode(mean)
    return float(offset.norm(dim=2).max()) * 1000
