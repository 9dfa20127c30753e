"""The trainer: three phases, one step at a time, with checkpoints that resume bit for bit.

The state of a run is its step number, the weights, the optimisers' moments and the mean mesh;
everything random in step n is drawn from (seed, n). So a run that stops and resumes gives the
numbers of one that never stopped, on the same machine with the same thread count.

A run whose losses or weights are not finite stops, and its last checkpoint stays. What a step
looks at is in `objectives`, what it draws in `drawing`.
"""

import json
import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import torch
from torch import Tensor
from torch.profiler import record_function

from pica_core.avatar.variants import VARIANTS
from pica_core.errors import CheckpointError, TrainingDivergedError
from pica_core.train.checkpoint import NAME, read_checkpoint, write_checkpoint
from pica_core.train.config import PHASES, TrainConfig
from pica_core.train.data.training import TrainingData
from pica_core.train.objectives import Objectives
from pica_core.train.optimiser import clip_groups, make_optimiser, rate_ratio
from pica_core.train.prior import face_prior
from pica_core.train.rasterise import Rasteriser

SCALE_TOLERANCE = 1e-5
"""Relative difference of position scales that two machines' sums may show for one capture."""
JOINT_COST = 4
"""Steps of the geometry phase that take as long as one joint step (measured: 42 and 11 a second on
one thread)."""
LIVE_TURN = 4
"""One of so many steps on pictures of poses is on frames instead, which keep what they taught."""
METRICS, METRICS_EVERY = "metrics.jsonl", 50
"""File of metrics in a run's folder, and the steps between its lines."""

Losses = dict[str, float]
logger = logging.getLogger(__name__)


class Trainer:
    """Trains one avatar on one capture.

    Args:
        run_dir: Where ``checkpoint.pt`` and ``metrics.jsonl`` go; made if missing.
        rasteriser: Made for the mesh that the model draws; it stays its owner's.

    Attributes:
        seconds: Time spent in steps since the run's beginning; checkpoints are not counted.
    """

    def __init__(
        self,
        data: TrainingData,
        config: TrainConfig,
        run_dir: Path,
        rasteriser: Rasteriser,
        *,
        device: torch.device | str = "cpu",
    ) -> None:
        self.data = data
        self.config = config
        self.run_dir = run_dir
        self.device = torch.device(device)
        run_dir.mkdir(parents=True, exist_ok=True)
        torch.manual_seed(config.seed)
        data.meshes.use(config.mesh_source)
        prior = face_prior(data, config.model.variant)
        self.model = config.model.build(prior).to(self.device)
        self.step = 0
        self.seconds = 0.0
        self.rasteriser = rasteriser
        self.objectives = Objectives(data, config, self.model, rasteriser, self.device)
        geometry, joint, driver = config.schedule.steps
        driver = driver if data.capture.has_expressions else 0
        self._has_live_steps = False
        if self.model.spec.geometry == "bases":  # nothing to descend: the steps go to colours
            geometry, joint = 0, joint + geometry // JOINT_COST
            live = min(config.schedule.live_steps, joint)
            self._has_live_steps = driver * live > 1 and self.objectives.has_pictures_of_poses
            # Without pictures a regression, which a descent from it only makes worse.
            driver = live if self._has_live_steps else min(driver, 1)
            joint -= live if self._has_live_steps else 0
        self._steps = geometry, joint, driver
        if prior.linear is not None:
            self.objectives.notes += prior.linear.notes
        last = "live" if self._has_live_steps else "driver"
        self._optimisers = {
            phase: make_optimiser(self.model, config.schedule, what)
            for phase, what in zip(PHASES, (*PHASES[:-1], last), strict=True)
        }

    @property
    def total_steps(self) -> int:
        """Steps of all phases together."""
        return sum(self._steps)

    def phase_of(self, step: int) -> tuple[str, int, int]:
        """Phase of a global step, the step within it, and the phase's length."""
        for phase, length in zip(PHASES, self._steps, strict=True):
            if step < length:
                return phase, step, length
            step -= length
        raise ValueError(f"step {self.step} lies behind the last phase")

    def run(self, on_step: Callable[[int, str, Losses], bool] | None = None) -> None:
        """Train from the current step to the end, with checkpoints on the way and at the end.

        `on_step` is told each step's number, phase and losses, and returns True to go on.

        Raises:
            TrainingDivergedError: Losses or weights are not finite. The last checkpoint stays.
            CheckpointError: A checkpoint cannot be written. The one before stays.
        """
        with (self.run_dir / METRICS).open("a") as metrics:
            for note in self.objectives.notes:
                logger.warning("step %d: %s", self.step, note)
                self._note(metrics, "note", {"text": note})
            self._run(metrics, on_step)

    def _run(self, metrics: TextIO, on_step: Callable[[int, str, Losses], bool] | None) -> None:
        first, first_s = self.step, self.seconds
        saved_at, goes_on = -1, True
        while goes_on and self.step < self.total_steps:
            phase, _, _ = self.phase_of(self.step)
            started = time.perf_counter()
            losses = self.train_step()
            self.seconds += time.perf_counter() - started
            if broken := [name for name, value in losses.items() if not math.isfinite(value)]:
                raise self._diverged(", ".join(broken))
            if self.step % METRICS_EVERY == 0:
                rate = (self.step - first) / max(self.seconds - first_s, 1e-9)
                first, first_s = self.step, self.seconds
                row = {"phase": phase, "seconds": round(self.seconds, 2)}
                row |= {"steps_per_s": round(rate, 3)}
                row |= {"left_s": round((self.total_steps - self.step) / rate), **losses}
                self._note(metrics, "train", row)
            if self.step == self.total_steps or self.step % self.config.checkpoint_every == 0:
                self.save()
                saved_at = self.step
            goes_on = on_step is None or on_step(self.step, phase, losses)
        if saved_at != self.step:
            self.save()

    def train_step(self) -> Losses:
        """Do one step and return its losses."""
        phase, index, length = self.phase_of(self.step)
        if phase == "driver" and index == 0 and self.model.spec.geometry == "bases":
            self.objectives.start_driver()
            if not self._has_live_steps:
                self._optimisers[phase].param_groups[0]["peak"] = 0.0
        schedule = self.config.schedule
        rng = np.random.default_rng([self.config.seed, self.step])
        noise = torch.Generator().manual_seed(self.config.seed * 1_000_003 + self.step)
        optimiser, kind = self._optimisers[phase], self._kind_of(self.step)
        ratio = 1.0 if schedule.constant_rate else rate_ratio(index, length)
        groups = optimiser.param_groups
        for group in groups:
            group["lr"] = group["peak"] * ratio
        optimiser.zero_grad(set_to_none=True)
        after = self.step + 1
        if after < self.total_steps and self._kind_of(after) == "joint":
            self.objectives.expect(np.random.default_rng([self.config.seed, after]))
        losses = self._losses(kind, rng, noise)
        with record_function("backward"):
            total = sum(losses.values(), torch.zeros((), device=self.device))
            total.backward()  # type: ignore[no-untyped-call]
        with record_function("optimiser"):
            clip_groups(optimiser, schedule.clip_norm)
            optimiser.step()
        self.step += 1
        values = torch.stack([value.detach() for value in losses.values()]).to("cpu")
        return dict(zip(losses, values.tolist(), strict=True))

    def _kind_of(self, step: int) -> str:
        """A step's phase; in one with pictures of poses every fourth "joint", the others "live"."""
        phase, index, _ = self.phase_of(step)
        if phase != "driver" or not self._has_live_steps:
            return phase
        return "live" if index % LIVE_TURN else "joint"

    def _losses(
        self, kind: str, rng: np.random.Generator, noise: torch.Generator
    ) -> dict[str, Tensor]:
        match kind:
            case "geometry":
                return self.objectives.geometry(rng, noise)
            case "joint":
                return self.objectives.joint(rng, noise, [self.config.seed, self.step])
            case "live":
                return self.objectives.live(rng, [self.config.seed, self.step])
            case _:
                return self.objectives.driver(rng)

    def save(self) -> Path:
        """Write the checkpoint aside, then move it into place.

        Raises:
            TrainingDivergedError: Weights are not finite; the checkpoint before stays.
            CheckpointError: It cannot be written; the one before stays.
        """
        with torch.no_grad():
            sums = torch.stack([p.sum() for p in self.model.parameters()])
        if not torch.isfinite(sums).all():
            raise self._diverged("weights")
        path = self.run_dir / NAME
        state = {
            "config": json.dumps(self.config.to_json()),
            "step": self.step,
            "position_scale_m": self.data.meshes.position_scale_m,
            "model": self.model.state_dict(),
            "optimisers": {name: o.state_dict() for name, o in self._optimisers.items()},
            "mean_mesh_m": self.objectives.mean_m,
            "seconds": self.seconds,
        }
        write_checkpoint(path, state)
        return path

    def restore(self) -> None:
        """Go on from the run's checkpoint.

        Raises:
            CheckpointError: None there, damaged, of another version, of other options, or of
                another capture.
        """
        state = read_checkpoint(self.run_dir / NAME)
        if TrainConfig.from_json(json.loads(state["config"])) != self.config:
            raise CheckpointError(
                f"{self.run_dir}: the checkpoint was made with other options; "
                "use the same ones, or another --out"
            )
        scale_m, here_m = state["position_scale_m"], self.data.meshes.position_scale_m
        if not math.isclose(scale_m, here_m, rel_tol=SCALE_TOLERANCE):
            raise CheckpointError(
                f"{self.run_dir}: the checkpoint was made on another capture than "
                f"{self.data.capture.path} (position scale {scale_m:.6g} m, here {here_m:.6g} m)"
            )
        self.model.load_state_dict(state["model"])
        for name, optimiser in self._optimisers.items():
            optimiser.load_state_dict(state["optimisers"][name])
        self.objectives.mean_m.copy_(state["mean_mesh_m"])
        self.objectives.forget_codes()
        self.step = state["step"]
        self.seconds = state["seconds"]

    def _diverged(self, what: str) -> TrainingDivergedError:
        phase, _, _ = self.phase_of(max(self.step - 1, 0))
        return TrainingDivergedError(
            f"step {self.step} ({phase}): {what} not finite; lower the learning rates and resume "
            f"from {self.run_dir}"
        )

    def _note(self, metrics: TextIO, kind: str, values: dict[str, Any]) -> None:
        metrics.write(json.dumps({"step": self.step, "kind": kind, **values}) + "\n")
        metrics.flush()


@contextmanager
def open_trainer(
    data: TrainingData,
    config: TrainConfig,
    run_dir: Path,
    *,
    device: torch.device | str = "cpu",
) -> Iterator[Trainer]:
    """A trainer with a rasteriser of its own, whose GL context is released at the end."""
    topology = data.meshes.topology(VARIANTS[config.model.variant].topology)
    with Rasteriser.of(topology) as rasteriser:
        yield Trainer(data, config, run_dir, rasteriser, device=device)
