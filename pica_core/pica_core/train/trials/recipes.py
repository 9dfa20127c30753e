"""Ways to train, to be compared as held-out error against seconds of training.

Each recipe changes one thing in a preset. `run_recipes` trains them one after the other and gives
the points of their curves; a curve is honest only if nothing else ran on the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from pica_core.train.config import PAPER_LOSSES, LossConfig, ScheduleConfig, TrainConfig
from pica_core.train.data.training import TrainingData
from pica_core.train.loop import open_trainer
from pica_core.train.monitor import curve

Recipe = Callable[[TrainConfig], TrainConfig]


def _schedule(change: Callable[[ScheduleConfig], ScheduleConfig]) -> Recipe:
    return lambda config: replace(config, schedule=change(config.schedule))


def _losses(change: Callable[[LossConfig], LossConfig]) -> Recipe:
    return lambda config: replace(config, losses=change(config.losses))


def _model(**changes: Any) -> Recipe:
    return lambda config: replace(config, model=replace(config.model, **changes))


RECIPES: dict[str, Recipe] = {
    "as_is": lambda config: config,
    "block_C": _model(block="C"),
    "block_H2": _model(block="H2"),
    "large_batches": _schedule(
        lambda schedule: replace(
            schedule,
            geometry_batch=4 * schedule.geometry_batch,
            geometry_steps=schedule.geometry_steps // 4,
            joint_batch=2 * schedule.joint_batch,
            joint_steps=schedule.joint_steps // 2,
        )
    ),
    "no_texture_at_start": _model(texture_contrast=0.0),
    "all_at_once": _schedule(
        lambda schedule: replace(
            schedule,
            geometry_steps=0,
            joint_steps=schedule.joint_steps + schedule.geometry_steps // 3,
        )
    ),
    "all_vertices_alike": _losses(
        lambda losses: replace(losses, region_weight=1.0, lid_weight=1.0)
    ),
    "all_frames_alike": _schedule(lambda schedule: replace(schedule, frame_balance=0.0)),
    "papers_start": _model(encoding_amplitude=1.0, texture_contrast=0.0),
    "papers_rates": _schedule(
        lambda schedule: replace(
            schedule, joint_rate=1e-3, pixel_rate=1e-3, encoding_rate=1e-3, constant_rate=True
        )
    ),
    "six_losses": _losses(
        lambda losses: replace(
            losses,
            depth=PAPER_LOSSES.depth,
            normal=PAPER_LOSSES.normal,
            smooth=PAPER_LOSSES.smooth,
        )
    ),
    "kl_4_times": _losses(lambda losses: replace(losses, kl=4 * losses.kl)),
    "silhouettes": _losses(lambda losses: replace(losses, edge=1.0)),
    "all_pixels": _schedule(lambda schedule: replace(schedule, pixels_per_image=0)),
    "tracked_meshes": lambda config: replace(config, mesh_source="tracked"),
}
"""all_at_once takes about the same time: a step without images costs a third of one with them."""


def run_recipes(
    data: TrainingData,
    config: TrainConfig,
    folder: Path,
    names: Iterable[str] = tuple(RECIPES),
    seeds: Iterable[int] = (0,),
) -> Iterator[dict[str, Any]]:
    """Train each recipe and give the points of its curve.

    Args:
        data: The capture.
        config: The preset that recipes change; `watch_every` says how dense the curves are.
        folder: Runs go into folders of their own.
        names: Keys of `RECIPES`.
        seeds: Of weights and batches.

    Yields:
        Rows of {recipe, seed, step, seconds, mse}: held-out error after so many seconds of steps.
    """
    for name in names:
        for seed in seeds:
            run = folder / f"{name}-{seed}"
            with open_trainer(data, replace(RECIPES[name](config), seed=seed), run) as trainer:
                trainer.run()
            for point in curve(run):
                yield {"recipe": name, "seed": seed, **point}
