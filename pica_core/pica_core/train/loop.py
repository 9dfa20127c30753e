"""The trainer: three phases, one step at a time, with checkpoints that resume bit for bit.

The state of a run is its step number, the weights, the optimisers' moments and the mean mesh;
everything random in step n is drawn from (seed, n). So a run that stops and resumes gives the
numbers of one that never stopped, on the same machine with the same thread count.

A run that diverges goes back to its last checkpoint with half the learning rates, a few times;
`metrics.jsonl` counts it. What a step looks at is in `objectives`, what it draws in `drawing`.
"""

import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.profiler import record_function

from pica_core.avatar.variants import VARIANTS
from pica_core.errors import (
    CheckpointError,
    PicaCoreError,
    TrainingDivergedError,
    TrainingMemoryError,
)
from pica_core.train.checkpoint import NAME, read_checkpoint, write_checkpoint
from pica_core.train.config import PHASES, TrainConfig
from pica_core.train.data.training import TrainingData
from pica_core.train.guard import DivergenceGuard
from pica_core.train.held_out import draw_held_out
from pica_core.train.monitor import Monitor
from pica_core.train.objectives import Objectives
from pica_core.train.optimiser import clip_groups, make_optimiser, rate_ratio
from pica_core.train.parallel import Ranks
from pica_core.train.prior import face_prior
from pica_core.train.rasterise import Rasteriser

SCALE_TOLERANCE = 1e-5
"""Relative difference of position scales that two machines' sums may show for one capture."""
JOINT_COST = 4
"""Steps of the geometry phase that take as long as one joint step (measured: 42 and 11 a second on
one thread)."""
LIVE_TURN = 4
"""One of so many steps on pictures of poses is on frames instead, which keep what they taught."""
METRICS_EVERY = 50
"""Steps between lines of metrics."""
ROLLBACK_RATE = 0.5
"""What a rollback leaves of the learning rates."""
_NO_MEMORY = ("can't allocate memory", "not enough memory", "out of memory")

Losses = dict[str, float]


class Trainer:
    """Trains one avatar on one capture.

    Args:
        run_dir: Where ``checkpoint.pt`` and ``metrics.jsonl`` go; made if missing.
        rasteriser: Made for the mesh that the model draws; it stays its owner's.
        ranks: This process among those that train together.

    Attributes:
        rollbacks: How often the run went back to a checkpoint.
        seconds: Time spent in steps since the run's beginning; looks and checkpoints not counted.
    """

    def __init__(
        self,
        data: TrainingData,
        config: TrainConfig,
        run_dir: Path,
        rasteriser: Rasteriser,
        *,
        device: torch.device | str = "cpu",
        ranks: Ranks | None = None,
    ) -> None:
        self.data = data
        self.config = config
        self.run_dir = run_dir
        self.device = torch.device(device)
        self.ranks = ranks or Ranks()
        run_dir.mkdir(parents=True, exist_ok=True)
        torch.manual_seed(config.seed)
        data.meshes.use(config.mesh_source)
        prior = face_prior(data, config.model.variant)
        self.model = config.model.build(prior).to(self.device)
        self.step = 0
        self.rollbacks = 0
        self.seconds = 0.0
        self._rate_scale = 1.0
        self.rasteriser = rasteriser
        self.objectives = Objectives(data, config, self.model, rasteriser, self.ranks, self.device)
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

        `on_step` is told each step's number, phase and losses, and says whether to go on.

        Raises:
            TrainingDivergedError: Losses are not finite or explode, and going back has not helped.
                The last checkpoint stays.
            TrainingMemoryError: A batch does not fit.
            CheckpointError: A checkpoint cannot be written. The one before stays.
        """
        with closing(Monitor(self.run_dir, is_silent=not self.ranks.is_first)) as monitor:
            for note in self.objectives.notes:
                monitor.note(self.step, note)
            self._run(monitor, on_step)

    def _run(self, monitor: Monitor, on_step: Callable[[int, str, Losses], bool] | None) -> None:
        guard = DivergenceGuard()
        first, first_s = self.step, self.seconds
        saved_at = -1
        while self.step < self.total_steps:
            phase, _, _ = self.phase_of(self.step)
            started = time.perf_counter()
            losses = self.train_step()
            self.seconds += time.perf_counter() - started
            problem = guard.check(phase, losses)
            is_last = self.step == self.total_steps
            is_due = is_last or self.step % self.config.checkpoint_every == 0
            if problem is None and is_due and not self._is_finite():
                problem = "weights not finite"
            if problem is not None:
                self._go_back(monitor, problem)
                guard = DivergenceGuard()
                first, first_s = self.step, self.seconds
                continue
            if self.step % METRICS_EVERY == 0:
                rate = (self.step - first) / max(self.seconds - first_s, 1e-9)
                first, first_s = self.step, self.seconds
                row: dict[str, Any] = {"phase": phase, "seconds": round(self.seconds, 2)}
                row |= {"steps_per_s": round(rate, 3)}
                row |= {"left_s": round((self.total_steps - self.step) / rate), **losses}
                monitor.row(self.step, "train", row)
            if self.config.watch_every and self.step % self.config.watch_every == 0:
                self._watch(monitor)
            if is_due:
                self.save()
                saved_at = self.step
            goes_on = on_step is None or on_step(self.step, phase, losses)
            if self.ranks.average(torch.tensor(float(goes_on))) < 1:
                break  # all processes stop if one does
        if saved_at != self.step:
            if not self._is_finite():
                self._go_back(monitor, "weights not finite")
            self.save()

    def train_step(self) -> Losses:
        """Do one step and return its losses.

        Raises:
            TrainingMemoryError: The batch does not fit into memory.
        """
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
            group["lr"] = group["peak"] * (self._rate_scale * ratio)
        optimiser.zero_grad(set_to_none=True)
        after = self.step + 1
        if after < self.total_steps and self._kind_of(after) == "joint":
            self.objectives.expect(np.random.default_rng([self.config.seed, after]))
        try:
            losses = self._losses(kind, rng, noise)
            with record_function("backward"):
                total = sum(losses.values(), torch.zeros((), device=self.device))
                total.backward()  # type: ignore[no-untyped-call]
                self.ranks.average_gradients(p for group in groups for p in group["params"])
            with record_function("optimiser"):
                clip_groups(optimiser, schedule.clip_norm)
                optimiser.step()
        except (MemoryError, RuntimeError) as error:
            told = isinstance(error, MemoryError) or any(text in str(error) for text in _NO_MEMORY)
            if isinstance(error, PicaCoreError) or not told:
                raise
            batch = getattr(schedule, f"{kind}_batch")
            pixels = schedule.pixels_per_image or "all"
            raise TrainingMemoryError(
                f"step {self.step} ({phase}): a batch of {batch} with {pixels} pixels an image "
                f"does not fit into memory; lower {kind}_batch or pixels_per_image"
            ) from error
        self.step += 1
        values = torch.stack([value.detach() for value in losses.values()]).to("cpu")
        return dict(zip(losses, self.ranks.average(values).tolist(), strict=True))

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
        """Write the checkpoint aside, then move it into place; the first process does it for all.

        Raises:
            CheckpointError: It cannot be written; the one before stays.
        """
        path = self.run_dir / NAME
        if self.ranks.is_first:
            state = {
                "config": json.dumps(self.config.to_json()),
                "step": self.step,
                "position_scale_m": self.data.meshes.position_scale_m,
                "model": self.model.state_dict(),
                "optimisers": {name: o.state_dict() for name, o in self._optimisers.items()},
                "mean_mesh_m": self.objectives.mean_m,
                "rate_scale": self._rate_scale,
                "rollbacks": self.rollbacks,
                "seconds": self.seconds,
            }
            write_checkpoint(path, state)
        self.ranks.wait()
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
        self._rate_scale = state["rate_scale"]
        self.rollbacks = state["rollbacks"]
        self.seconds = state["seconds"]

    def start_from(self, run_dir: Path) -> None:
        """Take the weights of another run, as a start instead of random ones.

        Mean map and position scale stay those of this capture.

        Raises:
            CheckpointError: None there, damaged, of another version, or of another model.
        """
        state = read_checkpoint(run_dir / NAME)
        own = {name for name, _ in self.model.named_buffers()}
        weights = {k: v for k, v in state["model"].items() if k not in own}
        try:
            missing, unexpected = self.model.load_state_dict(weights, strict=False)
        except RuntimeError as error:
            raise CheckpointError(f"{run_dir}: of another model: {error}") from error
        missing = [name for name in missing if name not in own]
        if missing or unexpected:
            raise CheckpointError(f"{run_dir}: of another model: {missing + unexpected}")

    def _go_back(self, monitor: Monitor, problem: str) -> None:
        """Return to the last checkpoint, or give up."""
        path = self.run_dir / NAME
        phase, _, _ = self.phase_of(self.step - 1)
        where = f"step {self.step} ({phase}): {problem}"
        if self.rollbacks >= self.config.max_rollbacks or not path.exists():
            tries = f"after {self.rollbacks} rollbacks" if self.rollbacks else "no way back"
            raise TrainingDivergedError(
                f"{where}; {tries}: lower the learning rates and resume from {self.run_dir}"
            )
        count, scale, diverged_at = self.rollbacks + 1, self._rate_scale, self.step
        seconds = self.seconds
        self.restore()
        self.seconds = seconds
        self.rollbacks, self._rate_scale = count, scale * ROLLBACK_RATE
        monitor.note(
            diverged_at,
            f"{where}; rollback {count} to step {self.step}, learning rates at "
            f"{self._rate_scale:g} of their schedule",
        )

    def _is_finite(self) -> bool:
        with torch.no_grad():
            sums = torch.stack([p.sum() for p in self.model.parameters()])
        return bool(torch.isfinite(sums).all())

    def _watch(self, monitor: Monitor) -> None:
        if self.ranks.is_first:
            mse, picture = draw_held_out(self.objectives)
            monitor.row(self.step, "held_out", {"seconds": round(self.seconds, 2), "mse": mse})
            monitor.picture(self.step, picture)
        self.ranks.wait()


@contextmanager
def open_trainer(
    data: TrainingData,
    config: TrainConfig,
    run_dir: Path,
    *,
    device: torch.device | str = "cpu",
    ranks: Ranks | None = None,
) -> Iterator[Trainer]:
    """A trainer with a rasteriser of its own, whose GL context is released at the end."""
    topology = data.meshes.topology(VARIANTS[config.model.variant].topology)
    with Rasteriser.of(topology) as rasteriser:
        yield Trainer(data, config, run_dir, rasteriser, device=device, ranks=ranks)
