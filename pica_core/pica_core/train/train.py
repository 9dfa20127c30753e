"""Joint learning as in the paper's section 5: phases of steps, and checkpoints that resume exactly.

    for each phase: for each step: batch -> losses of the phase -> step of its optimiser -> log

    geometry    encoder and geometry decoder on tracked meshes alone; no rendering (ours)
    joint       everything on images, meshes and KL, as in the paper
    driver      the expression encoder (52 ARKit values to the latent) on the model's own codes;
                of models with bases: a regression, then joint steps in turn with steps on
                pictures of poses, which teach it and the decoders what other expressions show

The state of a run is its step number, the weights, the optimisers' moments and the mean mesh;
everything random in step n is drawn from (seed, n). So a run that stops and resumes gives the
numbers of one that never stopped, on the same machine with the same thread count. A run whose
losses or weights are not finite stops, and its last checkpoint stays.
"""

import ctypes
import gc
import json
import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, TextIO

import torch
from torch import Tensor, nn

from pica_core.avatar.spec import VARIANTS
from pica_core.errors import TrainingDivergedError, TrainingError
from pica_core.files import replacing
from pica_core.model.interface import AvatarModel
from pica_core.train.config import TrainConfig
from pica_core.train.data import TrainingData, face_prior
from pica_core.train.objectives import LOSSES, Batch, Draw, Objectives
from pica_core.train.raster import GLRasteriser, Rasteriser, TensorRasteriser
from pica_core.train.replay import ReplayedStep

PHASES = ("geometry", "joint", "driver")
JOINT_COST = 4
"""Steps of the geometry phase that take as long as one joint step (measured: 42 and 11 a second on
one thread)."""
LIVE_TURN = 4
"""One of so many steps on pictures of poses is on frames instead, which keep what they taught."""
GEOMETRY_RATE, DRIVER_RATE = 4e-3, 2e-3
"""Peak learning rates of the phases that are ours."""
LIVE_RATE_RATIO = 0.5
"""Rates on pictures of poses, when all is learned but for what they add, against the joint ones."""
WARMUP_RATIO = 0.02
"""Part of a phase in which the learning rate rises linearly."""
FINAL_RATE_RATIO = 0.02
"""Learning rate at the end of a phase, against its peak; between them half a cosine."""
METRICS, METRICS_EVERY = "metrics.jsonl", 50
"""File of metrics in a run's folder, and the steps between its lines."""
CHECKPOINT, CHECKPOINT_VERSION = "checkpoint.pt", 6
MALLOPT, MOST_KEPT = (-1, -3), 1 << 30
"""M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of glibc, and bytes that are kept."""
DECODED_AHEAD = 4
"""Steps whose images are being decoded."""
SCALE_TOLERANCE = 1e-5
"""Relative difference of position scales that two machines' sums may show for one capture."""

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
        self.data, self.config, self.run_dir = data, config, run_dir
        self.device = torch.device(device)
        run_dir.mkdir(parents=True, exist_ok=True)
        torch.manual_seed(config.seed)
        data.meshes.use(config.mesh_source)
        prior = face_prior(data, config.variant)
        self.model = config.build(prior).to(self.device)
        self.step, self.seconds = 0, 0.0
        self.rasteriser = rasteriser
        self.objectives = Objectives(data, config, self.model, rasteriser, self.device)
        geometry, joint = config.geometry_steps, config.joint_steps
        driver = config.driver_steps if data.capture.has_expressions else 0
        self._has_live_steps = False
        if self.model.spec.geometry == "bases":  # nothing to descend: the steps go to colours
            geometry, joint = 0, joint + geometry // JOINT_COST
            live = min(config.live_steps, joint)
            self._has_live_steps = driver * live > 1 and self.objectives.has_pictures_of_poses
            # Without pictures a regression, which a descent from it only makes worse.
            driver = live if self._has_live_steps else min(driver, 1)
            joint -= live if self._has_live_steps else 0
        self._steps = geometry, joint, driver
        self._next: Batch | None = None
        self._names: dict[str, tuple[str, ...]] = {}
        self._replayed: dict[str, ReplayedStep] = {}
        self._replayed_phase = ""
        last = "live" if self._has_live_steps else "driver"
        self._optimisers = {
            phase: make_optimiser(self.model, config, what)
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

    def run(self, on_step: Callable[[int, str, dict[str, float]], bool] | None = None) -> None:
        """Train from the current step to the end, with checkpoints on the way and at the end.

        `on_step` is told each step's number, phase and losses, and returns True to go on.

        Raises:
            TrainingDivergedError: Losses or weights are not finite. The last checkpoint stays.
            TrainingError: A checkpoint cannot be written. The one before stays.
        """
        with (self.run_dir / METRICS).open("a") as metrics, undisturbed():
            for note in self.objectives.notes:
                logger.warning("step %d: %s", self.step, note)
                self._log(metrics, "note", {"text": note})
            while self.step < self.total_steps:
                phase, _, _ = self.phase_of(self.step)
                started = time.perf_counter()
                losses = self.train_step()
                self.seconds += time.perf_counter() - started
                if broken := [name for name, loss in losses.items() if not math.isfinite(loss)]:
                    raise self._diverged(", ".join(broken))
                if self.step % METRICS_EVERY == 0:
                    row = {"phase": phase, "seconds": round(self.seconds, 2), **losses}
                    self._log(metrics, "train", row)
                if self.step % self.config.checkpoint_every == 0:
                    self.save()
                if on_step is not None and not on_step(self.step, phase, losses):
                    break
            self.save()

    def train_step(self) -> dict[str, float]:
        """Do one step and return its losses."""
        phase, index, length = self.phase_of(self.step)
        optimiser = self._optimisers[phase]
        if phase == "driver" and index == 0 and self.model.spec.geometry == "bases":
            self.objectives.start_driver()
            if not self._has_live_steps:
                optimiser.param_groups[0]["peak"] = 0.0
        ratio = 1.0 if self.config.constant_rate else rate_ratio(index, length)
        for group in optimiser.param_groups:
            if isinstance(group["lr"], Tensor):
                group["lr"].fill_(group["peak"] * ratio)
            else:
                group["lr"] = group["peak"] * ratio
        kind = self._kind_of(self.step)
        batch = self._next if self._next is not None else self._prepared(self.step)
        values = self._steps_of(phase, kind)(batch)
        self.step += 1
        self._next = None
        if self.step < self.total_steps and self.phase_of(self.step)[0] == phase:
            ahead = self.step + DECODED_AHEAD
            if ahead < self.total_steps and self._kind_of(ahead) == "joint":
                self.objectives.expect(Draw(self.config.seed, ahead))
            if self.device.type != "cpu":  # while the GPU is at work
                self._next = self._prepared(self.step)
        return dict(zip(self._names[kind], values.tolist(), strict=False))

    def _prepared(self, step: int) -> Batch:
        return self.objectives.prepare(self._kind_of(step), Draw(self.config.seed, step))

    def _steps_of(self, phase: str, kind: str) -> Callable[[Batch], Tensor]:
        """What does steps of a kind: repeated from a CUDA graph where there is a GPU."""
        work = partial(self._work, phase, kind)
        if self.device.type == "cpu":
            return work
        if self._replayed_phase != phase:  # the graphs of another phase hold memory
            self._replayed, self._replayed_phase = {}, phase
        if kind not in self._replayed:
            sizes = [self.objectives.drawer.capacity]
            if isinstance(self.rasteriser, TensorRasteriser):
                sizes.append(self.rasteriser.capacity)
            self._replayed[kind] = ReplayedStep(work, sizes, self.device)
        return self._replayed[kind]

    def _work(self, phase: str, kind: str, batch: Batch) -> Tensor:
        """One step of the phase's optimiser on a batch of the model's device; its losses."""
        optimiser = self._optimisers[phase]
        optimiser.zero_grad(set_to_none=True)
        losses = LOSSES[kind](self.objectives, batch)
        self._names[kind] = tuple(losses)
        values = list(losses.values())
        sum(values[1:], values[0]).backward()  # type: ignore[no-untyped-call]
        if self.config.clip_norm > 0:  # by group: their losses differ in scale by thousands
            for group in optimiser.param_groups:
                nn.utils.clip_grad_norm_(group["params"], self.config.clip_norm)
        optimiser.step()
        return torch.stack([value.detach() for value in values])

    def _kind_of(self, step: int) -> str:
        """A step's phase; in one with pictures of poses every fourth "joint", the others "live"."""
        phase, index, _ = self.phase_of(step)
        if phase != "driver" or not self._has_live_steps:
            return phase
        return "live" if index % LIVE_TURN else "joint"

    def save(self, run: Path | None = None, *, light: bool = False) -> None:
        """Write the checkpoint aside, then move it into place.

        Args:
            run: Another folder than the run's.
            light: Weights in half precision and no moments: a fifth of the bytes, from which a run
                goes on, but not bit for bit.

        Raises:
            TrainingDivergedError: Weights are not finite; the checkpoint before stays.
            TrainingError: It cannot be written; the one before stays.
        """
        with torch.no_grad():
            sums = torch.stack([p.sum() for p in self.model.parameters()])
        if not torch.isfinite(sums).all():
            raise self._diverged("weights")
        weights, moments = self.model.state_dict(), self._optimisers
        if light:
            moments = {}
            weights |= {name: p.detach().half() for name, p in self.model.named_parameters()}
        state = {
            "config": asdict(self.config),
            "capture": str(self.data.capture.path.resolve()),
            "step": self.step,
            "position_scale_m": self.data.meshes.position_scale_m,
            "model": weights,
            "moments": {name: each.state_dict()["state"] for name, each in moments.items()},
            "mean_mesh_m": self.objectives.mean_m,
            "seconds": self.seconds,
        }
        write_checkpoint((run or self.run_dir) / CHECKPOINT, state)

    def restore(self, run: Path | None = None) -> None:
        """Go on from the checkpoint of the run, or of another folder.

        Raises:
            TrainingError: None there, damaged, of another version, of other options, or of
                another capture.
        """
        state = read_checkpoint(run or self.run_dir)
        ours, theirs = asdict(self.config), asdict(state["config"])
        if other := [f"{name} {theirs[name]}" for name in ours if ours[name] != theirs[name]]:
            raise TrainingError(
                f"{self.run_dir}: the checkpoint was made with other options "
                f"({', '.join(other)}); use the same ones, or another --out"
            )
        scale_m, here_m = state["position_scale_m"], self.data.meshes.position_scale_m
        if not math.isclose(scale_m, here_m, rel_tol=SCALE_TOLERANCE):
            raise TrainingError(
                f"{self.run_dir}: the checkpoint was made on another capture than "
                f"{self.data.capture.path} (position scale {scale_m:.6g} m, here {here_m:.6g} m)"
            )
        self.model.load_state_dict(state["model"])
        for name in state["moments"]:
            optimiser = self._optimisers[name]
            moments = {"state": state["moments"][name]}
            optimiser.load_state_dict(optimiser.state_dict() | moments)
        self.objectives.mean_m.copy_(state["mean_mesh_m"])
        self.step, self.seconds = state["step"], state["seconds"]
        self._next, self._replayed = None, {}

    def _diverged(self, what: str) -> TrainingDivergedError:
        phase, _, _ = self.phase_of(max(self.step - 1, 0))
        return TrainingDivergedError(
            f"step {self.step} ({phase}): {what} not finite; lower the learning rates and resume "
            f"from {self.run_dir}"
        )

    def _log(self, metrics: TextIO, kind: str, values: dict[str, Any]) -> None:
        metrics.write(json.dumps({"step": self.step, "kind": kind, **values}) + "\n")
        metrics.flush()


@contextmanager
def open_trainer(
    data: TrainingData, config: TrainConfig, run_dir: Path, *, device: torch.device | str = "cpu"
) -> Iterator[Trainer]:
    """A trainer with a rasteriser of its own; one of GL, on the CPU, is released at the end."""
    topology = data.meshes.topology(VARIANTS[config.variant].topology)
    if torch.device(device).type != "cpu":
        faces = TensorRasteriser(topology.faces, device)
        yield Trainer(data, config, run_dir, faces, device=device)
        return
    with GLRasteriser.of(topology) as rasteriser:
        yield Trainer(data, config, run_dir, rasteriser)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Collect what the run before has left, leave what is there out of garbage collections, and let
    glibc keep the memory that a step frees for the next one, which otherwise asks for up to 10,000
    pages again."""
    with suppress(AttributeError, TypeError):  # another C library
        for option in MALLOPT:
            ctypes.CDLL(None).mallopt(option, MOST_KEPT)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def make_optimiser(model: AvatarModel, config: TrainConfig, phase: str) -> torch.optim.Adam:
    """Adam over the parameters of a phase, one of `PHASES` or "live", a driver phase with pictures
    of poses; each group keeps its peak rate as ``"peak"``."""
    of, expression = model.parameter_groups(), model.expression_encoder
    joint = [
        ([*of["shape"], *of["appearance"]], config.joint_rate),
        (of["pixel"], config.pixel_rate),
        (of["encoding"], config.encoding_rate),
    ]
    match phase:
        case "geometry":
            groups = [(of["shape"], GEOMETRY_RATE)]
        case "joint":
            groups = joint
        case "live":
            groups = [(params, LIVE_RATE_RATIO * rate) for params, rate in joint]
            groups.append((list(expression.layers[-1].parameters()), DRIVER_RATE))
        case _:
            groups = [(list(expression.parameters()), DRIVER_RATE)]
    device = next(model.parameters()).device
    is_gpu = device.type != "cpu"  # where a graph repeats steps, and reads the rate of a tensor
    return torch.optim.Adam(
        [
            {"params": params, "peak": rate}
            | {"lr": torch.tensor(rate, device=device) if is_gpu else rate}
            for params, rate in groups
            if params
        ],
        fused=True,
        capturable=is_gpu,
    )


def rate_ratio(index: int, length: int) -> float:
    """Learning rate of a phase's step against its peak: linear warm-up, then half a cosine."""
    warm = min(1.0, (index + 1) / max(1.0, WARMUP_RATIO * length))
    cosine = 0.5 + 0.5 * math.cos(math.pi * index / max(1, length))
    return warm * (FINAL_RATE_RATIO + (1 - FINAL_RATE_RATIO) * cosine)


def write_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint; whatever happens, the file of before or the new one is there, whole.

    Raises:
        TrainingError: It cannot be written, for example because the disk is full.
    """
    try:
        with replacing(path) as unfinished:
            torch.save({"version": CHECKPOINT_VERSION, **state}, unfinished)
    except (OSError, RuntimeError) as error:  # torch's writer turns an OSError into RuntimeError
        kept = "the one before is whole" if path.exists() else "there is none yet"
        raise TrainingError(f"{path}: checkpoint cannot be written ({error}); {kept}") from error


def read_checkpoint(run: Path) -> dict[str, Any]:
    """Read the state in a run's folder: tensors and plain values, no code; its "config" as
    `TrainConfig`.

    Raises:
        TrainingError: Missing, damaged or of another version.
    """
    path = run / CHECKPOINT
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise TrainingError(f"{path}: no checkpoint there") from error
    except Exception as error:  # torch.load raises many types for a damaged file
        raise TrainingError(f"{path}: not a readable checkpoint ({error})") from error
    if not isinstance(state, dict) or state.get("version") != CHECKPOINT_VERSION:
        raise TrainingError(f"{path}: checkpoint version is not {CHECKPOINT_VERSION}")
    return {**state, "config": TrainConfig(**state["config"])}
