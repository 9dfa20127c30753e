"""Ways to train, to be compared as held-out error against seconds of training.

Each recipe changes one thing in a preset. `run_recipes` trains them one after the other and gives
the points of their curves; a curve is honest only if nothing else ran on the machine.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from pica_core.train.config import PAPER_LOSSES, TrainConfig
from pica_core.train.data.training import TrainingData
from pica_core.train.loop import open_trainer
from pica_core.train.monitor import curve

Recipe = Callable[[TrainConfig], TrainConfig]


def _large_batches(config: TrainConfig) -> TrainConfig:
    schedule = config.schedule
    changes = {
        "geometry_batch": 4 * schedule.geometry_batch,
        "geometry_steps": schedule.geometry_steps // 4,
        "joint_batch": 2 * schedule.joint_batch,
        "joint_steps": schedule.joint_steps // 2,
    }
    return config.changed(schedule=changes)


def _all_at_once(config: TrainConfig) -> TrainConfig:
    schedule = config.schedule
    steps = schedule.joint_steps + schedule.geometry_steps // 3
    return config.changed(schedule={"geometry_steps": 0, "joint_steps": steps})


def _change(**parts: dict[str, Any]) -> Recipe:
    return lambda config: config.changed(**parts)


RECIPES: dict[str, Recipe] = {
    "as_is": lambda config: config,
    "block_C": _change(model={"block": "C"}),
    "block_H2": _change(model={"block": "H2"}),
    "large_batches": _large_batches,
    "no_texture_at_start": _change(model={"texture_contrast": 0.0}),
    "all_at_once": _all_at_once,
    "all_vertices_alike": _change(losses={"region_weight": 1.0, "lid_weight": 1.0}),
    "all_frames_alike": _change(schedule={"frame_balance": 0.0}),
    "papers_start": _change(model={"encoding_amplitude": 1.0, "texture_contrast": 0.0}),
    "papers_rates": _change(
        schedule={
            **dict.fromkeys(("joint_rate", "pixel_rate", "encoding_rate"), 1e-3),
            "constant_rate": True,
        }
    ),
    "six_losses": _change(
        losses={name: getattr(PAPER_LOSSES, name) for name in ("depth", "normal", "smooth")}
    ),
    "kl_4_times": lambda config: config.changed(losses={"kl": 4 * config.losses.kl}),
    "silhouettes": _change(losses={"edge": 1.0}),
    "all_pixels": _change(schedule={"pixels_per_image": 0}),
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
