"""The trainer: three phases, one step at a time, with checkpoints that resume bit for bit.

The state of a run is its step number, the weights and the optimiser's moments; everything random in
step n is drawn from (seed, n). So a run that stops and resumes gives the numbers of one that never
stopped, on the same machine with the same thread count.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pica_core.errors import CheckpointError, TrainingDivergedError
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.model.decoders import sample_map
from pica_core.model.encoder import reparameterise, resize_texture
from pica_core.model.interface import Surface
from pica_core.train.config import PHASES, TrainConfig
from pica_core.train.data import TrainingData, view_direction
from pica_core.train.losses import image_loss, kl_loss, mesh_loss
from pica_core.train.prior import face_prior
from pica_core.train.rasterise import Rasteriser, interpolate

CHECKPOINT_VERSION = 1
WARMUP_RATIO = 0.02
"""Part of a phase in which the learning rate rises linearly."""
FINAL_RATE_RATIO = 0.02
"""Learning rate at the end of a phase, against its peak; between them half a cosine."""

SCALE_TOLERANCE = 1e-5
"""Relative difference of position scales that two machines' sums may show for one capture."""

Losses = dict[str, float]


class Trainer:
    """Trains one avatar on one capture.

    Args:
        data: The capture as tensors.
        config: Options of the run.
        run_dir: Where ``checkpoint.pt`` and ``metrics.jsonl`` go; made if missing.
    """

    def __init__(self, data: TrainingData, config: TrainConfig, run_dir: Path) -> None:
        self.data = data
        self.config = config
        self.run_dir = run_dir
        run_dir.mkdir(parents=True, exist_ok=True)
        torch.manual_seed(config.seed)
        self.model = PixelCodecAvatar(
            config.model.spec(),
            face_prior(data),
            encoder=config.model.encoder,
            encoding_amplitude=config.model.encoding_amplitude,
            first_frequency=config.model.first_frequency,
        )
        self.step = 0
        self.rasteriser = Rasteriser(data.faces.numpy().astype(np.int32), len(data.mean_vertices_m))
        weights = np.where(data.important, config.losses.region_weight, 1.0)
        weights[data.lids] = config.losses.lid_weight
        self._vertex_weights = torch.from_numpy(weights.astype(np.float32))
        important_faces = data.important[data.faces.numpy()].all(1)
        self._face_weights = np.where(important_faces, config.losses.region_weight, 1.0)
        self._optimisers = {phase: self._optimiser(phase) for phase in PHASES}
        self._codes: tuple[dict[int, Tensor], Tensor] | None = None

    def close(self) -> None:
        """Release the GL context."""
        self.rasteriser.release()

    @property
    def total_steps(self) -> int:
        """Steps of all phases together."""
        return sum(self.config.schedule.steps)

    def phase_of(self, step: int) -> tuple[str, int, int]:
        """Phase of a global step, the step within it, and the phase's length."""
        for phase, length in zip(PHASES, self.config.schedule.steps, strict=True):
            if step < length:
                return phase, step, length
            step -= length
        raise ValueError(f"step {self.step} lies behind the last phase")

    def run(self, on_step: Callable[[int, str, Losses], bool] | None = None) -> None:
        """Train from the current step to the end, with checkpoints on the way and at the end.

        Args:
            on_step: Called after every step with the step's number, phase and losses; returns
                whether to go on.

        Raises:
            TrainingDivergedError: A loss is not finite. The last checkpoint stays.
        """
        with (self.run_dir / "metrics.jsonl").open("a") as metrics:
            started = time.perf_counter()
            while self.step < self.total_steps:
                phase, _, _ = self.phase_of(self.step)
                losses = self.train_step()
                if not all(math.isfinite(value) for value in losses.values()):
                    raise TrainingDivergedError(
                        f"step {self.step} ({phase}): losses are {losses}; "
                        f"lower the learning rate and resume from {self.run_dir}"
                    )
                if self.step % 50 == 0:
                    seconds = round(time.perf_counter() - started, 2)
                    row = {"step": self.step, "phase": phase, "seconds": seconds, **losses}
                    metrics.write(json.dumps(row) + "\n")
                    metrics.flush()
                if self.step % self.config.checkpoint_every == 0:
                    self.save()
                if on_step is not None and not on_step(self.step, phase, losses):
                    break
        self.save()

    def train_step(self) -> Losses:
        """Do one step and return its losses."""
        phase, index, length = self.phase_of(self.step)
        rng = np.random.default_rng([self.config.seed, self.step])
        noise = torch.Generator().manual_seed(self.config.seed * 1_000_003 + self.step)
        optimiser = self._optimisers[phase]
        for group in optimiser.param_groups:
            group["lr"] = group["peak"] * rate_ratio(index, length)
        optimiser.zero_grad(set_to_none=True)
        match phase:
            case "geometry":
                losses = self._geometry_losses(rng, noise)
            case "joint":
                losses = self._joint_losses(rng, noise)
            case _:
                losses = self._driver_losses(rng)
        total = sum(losses.values(), torch.zeros(()))
        total.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(
            [p for group in optimiser.param_groups for p in group["params"]], 1.0
        )
        optimiser.step()
        self.step += 1
        return {name: float(value.detach()) for name, value in losses.items()}

    def encode(self, frames: list[int]) -> tuple[Tensor, Tensor]:
        """The encoder's mean and log-variance of frames, ``[N, 4, 8, 8]`` each."""
        textures = resize_texture(self.data.textures(frames), self.model.encoder.texture_size)
        mean, log_variance = self.model.encoder(textures, self.data.position_maps(frames))
        return mean, log_variance

    def surface(
        self,
        vertices_m: Tensor,
        frames: list[int],
        cameras: list[str],
        rng: np.random.Generator,
        *,
        every_pixel: bool = False,
    ) -> tuple[Surface, Tensor]:
        """Draw covered pixels of some images.

        Args:
            vertices_m: Decoded vertices, ``[N, V, 3]``.
            frames: Frame of each image.
            cameras: Camera name of each image.
            rng: Source of the choice of pixels.
            every_pixel: Take all covered pixels, in order, instead of drawing some.

        Returns:
            The pixels' surface points and the images' colours there, ``[P, 3]``.
        """
        parts: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []
        for index, (frame, name) in enumerate(zip(frames, cameras, strict=True)):
            camera = self.data.camera(frame, name)
            mesh = vertices_m[index]
            ids = self.rasteriser.triangle_ids(mesh.detach().numpy(), camera)
            pixels = np.flatnonzero(ids >= 0) if every_pixel else self._draw_pixels(ids, rng)
            uv, xyz_m, _ = interpolate(
                mesh, self.data.vertex_uv, self.data.faces, camera, ids, pixels
            )
            colours = self.data.image(frame, name).reshape(-1, 3)[pixels]
            observed = torch.from_numpy(colours).to(torch.float32) / 255
            parts.append((torch.full((len(uv),), index), uv, xyz_m, observed))
        image, uv, xyz_m, observed = (torch.cat(column) for column in zip(*parts, strict=True))
        return Surface(image, uv, xyz_m), observed

    def save(self) -> Path:
        """Write the checkpoint aside, then move it into place."""
        path = self.run_dir / "checkpoint.pt"
        aside = path.with_suffix(".part")
        state = {
            "version": CHECKPOINT_VERSION,
            "config": json.dumps(self.config.to_json()),
            "step": self.step,
            "position_scale_m": self.data.position_scale_m,
            "model": self.model.state_dict(),
            "optimisers": {name: o.state_dict() for name, o in self._optimisers.items()},
        }
        torch.save(state, aside)
        os.replace(aside, path)
        return path

    def restore(self) -> None:
        """Go on from the run's checkpoint.

        Raises:
            CheckpointError: None there, damaged, of another version, of other options, or of
                another capture.
        """
        state = read_checkpoint(self.run_dir / "checkpoint.pt")
        if state["config"] != json.dumps(self.config.to_json()):
            raise CheckpointError(
                f"{self.run_dir}: the checkpoint was made with other options; "
                "use the same ones, or another --out"
            )
        scale_m, here_m = state["position_scale_m"], self.data.position_scale_m
        if not math.isclose(scale_m, here_m, rel_tol=SCALE_TOLERANCE):
            raise CheckpointError(
                f"{self.run_dir}: the checkpoint was made on another capture than "
                f"{self.data.capture.path} (position scale {scale_m:.6g} m, here {here_m:.6g} m)"
            )
        self.model.load_state_dict(state["model"])
        for name, optimiser in self._optimisers.items():
            optimiser.load_state_dict(state["optimisers"][name])
        self.step = state["step"]

    def start_from(self, run_dir: Path) -> None:
        """Take the weights of another run, as a start instead of random ones.

        Mean map and position scale stay those of this capture.

        Raises:
            CheckpointError: None there, damaged, of another version, or of another model.
        """
        state = read_checkpoint(run_dir / "checkpoint.pt")
        weights = {k: v for k, v in state["model"].items() if k != "position_mean"}
        try:
            missing, unexpected = self.model.load_state_dict(weights, strict=False)
        except RuntimeError as error:
            raise CheckpointError(f"{run_dir}: of another model: {error}") from error
        if missing != ["position_mean"] or unexpected:
            raise CheckpointError(f"{run_dir}: of another model: {missing + unexpected}")

    def _optimiser(self, phase: str) -> torch.optim.Adam:
        model, schedule = self.model, self.config.schedule
        shape = [*model.encoder.parameters(), *model.geometry.parameters()]
        match phase:
            case "geometry":
                groups = [(shape, schedule.geometry_rate)]
            case "joint":
                shape += model.expression.parameters()
                pixel = model.pixel_decoder
                nets = [*pixel.xyz.parameters(), *pixel.colour.parameters()]
                groups = [
                    (shape, schedule.joint_rate),
                    (nets, schedule.pixel_rate),
                    (list(pixel.encoding.parameters()), schedule.encoding_rate),
                ]
            case _:
                groups = [(list(model.expression_encoder.parameters()), schedule.driver_rate)]
        return torch.optim.Adam(
            [{"params": params, "lr": rate, "peak": rate} for params, rate in groups], fused=True
        )

    def _geometry_losses(
        self, rng: np.random.Generator, noise: torch.Generator
    ) -> dict[str, Tensor]:
        frames = self._draw_frames(self.config.schedule.geometry_batch, rng)
        latent, kl = self._latent(frames, noise)
        vertices_m = sample_map(self.model.decode_geometry(latent), self.data.vertex_uv)
        return {"mesh": self._mesh(vertices_m, frames), "kl": self.config.losses.kl * kl}

    def _joint_losses(self, rng: np.random.Generator, noise: torch.Generator) -> dict[str, Tensor]:
        frames = self._draw_frames(self.config.schedule.joint_batch, rng)
        cameras = rng.choice(self.data.camera_names, len(frames)).tolist()
        latent, kl = self._latent(frames, noise)
        vertices_m = sample_map(self.model.decode_geometry(latent), self.data.vertex_uv)
        surface, observed = self.surface(vertices_m, frames, cameras, rng)
        view = torch.stack(
            [
                torch.from_numpy(view_direction(self.data.camera(frame, name)))
                for frame, name in zip(frames, cameras, strict=True)
            ]
        )
        codes = self.model.decode_expression(latent, view)
        colours = self.model.shade(codes, surface, detach_xyz=self.config.detach_pixel_xyz)
        weights = self.config.losses
        return {
            "image": weights.image * image_loss(colours, observed),
            "mesh": self._mesh(vertices_m, frames),
            "kl": weights.kl * kl,
        }

    def _driver_losses(self, rng: np.random.Generator) -> dict[str, Tensor]:
        codes, spread = self._model_codes()
        frames = self._draw_frames(self.config.schedule.driver_batch, rng)
        latent = self.model.expression_encoder(self.data.arkit[frames])
        wanted = torch.stack([codes[frame] for frame in frames])
        few = slice(0, 4)
        vertices_m = sample_map(self.model.decode_geometry(latent[few]), self.data.vertex_uv)
        return {
            "code": ((latent - wanted) / spread).square().mean(),
            "mesh": self._mesh(vertices_m, frames[few]),
        }

    def _model_codes(self) -> tuple[dict[int, Tensor], Tensor]:
        """The encoder's mean of each training frame, and the overall deviation of all."""
        if self._codes is None:
            frames = self.data.train_frames
            with torch.no_grad():
                means = [self.encode(frames[i : i + 16])[0] for i in range(0, len(frames), 16)]
            codes = torch.cat(means)
            by_frame = dict(zip(frames, codes, strict=True))
            self._codes = by_frame, codes.std().clamp_min(1e-6)
        return self._codes

    def _draw_frames(self, count: int, rng: np.random.Generator) -> list[int]:
        return self.data.draw_frames(count, self.config.schedule.frame_balance, rng)

    def _latent(self, frames: list[int], noise: torch.Generator) -> tuple[Tensor, Tensor]:
        mean, log_variance = self.encode(frames)
        sample = reparameterise(mean, log_variance, torch.randn(mean.shape, generator=noise))
        return sample, kl_loss(mean, log_variance)

    def _mesh(self, vertices_m: Tensor, frames: list[int]) -> Tensor:
        tracked = self.data.meshes(frames)
        return self.config.losses.mesh * mesh_loss(vertices_m, tracked, self._vertex_weights)

    def _draw_pixels(
        self, ids: np.ndarray[Any, np.dtype[np.int32]], rng: np.random.Generator
    ) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Covered pixels of an image, important ones more often; sorted, without repetition."""
        covered = np.flatnonzero(ids >= 0)
        wanted = self.config.schedule.pixels_per_image
        if wanted == 0 or len(covered) <= wanted:
            return covered
        weights = self._face_weights[ids.reshape(-1)[covered]]
        # Keys u^(1/w), largest win: weighted sampling without replacement (Efraimidis, Spirakis).
        keys = np.log(rng.random(len(covered))) / weights
        return np.sort(covered[np.argpartition(keys, -wanted)[-wanted:]])


def rate_ratio(index: int, length: int) -> float:
    """Learning rate of a phase's step against its peak: linear warm-up, then half a cosine."""
    warm = min(1.0, (index + 1) / max(1.0, WARMUP_RATIO * length))
    cosine = 0.5 + 0.5 * math.cos(math.pi * index / max(1, length))
    return warm * (FINAL_RATE_RATIO + (1 - FINAL_RATE_RATIO) * cosine)


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint's state; tensors and plain values only, no code.

    Raises:
        CheckpointError: Missing, damaged or of another version.
    """
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: no checkpoint there") from error
    except Exception as error:  # torch.load raises many types for a damaged file
        raise CheckpointError(f"{path}: not a readable checkpoint ({error})") from error
    if not isinstance(state, dict) or state.get("version") != CHECKPOINT_VERSION:
        raise CheckpointError(f"{path}: checkpoint version is not {CHECKPOINT_VERSION}")
    return state


@contextmanager
def open_trainer(data: TrainingData, config: TrainConfig, run_dir: Path) -> Iterator[Trainer]:
    """A trainer whose GL context is released at the end."""
    trainer = Trainer(data, config, run_dir)
    try:
        yield trainer
    finally:
        trainer.close()
