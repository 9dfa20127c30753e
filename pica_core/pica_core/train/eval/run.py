"""Finished runs, opened for evaluation, and everything that is measured of one."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pica_core.avatar.variants import VARIANTS
from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import CheckpointError, TrainingOptionError, check_ranges
from pica_core.model.interface import AvatarModel
from pica_core.train.checkpoint import read_checkpoint
from pica_core.train.config import TrainConfig
from pica_core.train.data.sampler import spaced
from pica_core.train.data.training import TrainingData
from pica_core.train.eval.evaluate import measure_views
from pica_core.train.eval.metrics import mse, psnr_db
from pica_core.train.eval.model_evaluator import ModelEvaluator
from pica_core.train.eval.truth import (
    NOT_ASKED,
    DepthErrors,
    NearField,
    TrueView,
    near_field,
    tracked_errors,
    true_views,
)
from pica_core.train.prior import face_prior
from pica_core.train.rasterise import Rasteriser
from pica_core.types import ByteArray

RUN_FILE = "run.json"
"""What `pica train` writes down of a run beside its checkpoint."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Run:
    """A folder of `pica train`, as far as it can be read without its capture."""

    folder: Path
    capture: Path
    config: TrainConfig
    steps: int
    """Steps that were trained."""
    weights: dict[str, Any]
    """The model's state."""

    @property
    def variant(self) -> str:
        """Which model it trained."""
        return self.config.model.variant

    @property
    def block(self) -> str | None:
        """Block of its per-object decoders; None where there are none."""
        is_codec = VARIANTS[self.variant].network == "pixel_codec"
        return self.config.model.block if is_codec else None


@dataclass(frozen=True, kw_only=True, slots=True)
class EvalLimits:
    """How much to measure."""

    split: Literal["train", "test"] = "test"
    """Held-out frames, or for comparison those that were trained on."""
    frames: int = 25
    """How many of them, evenly spaced."""
    geometry_frames: int = 8
    """How many of these to compare the geometry of; 0 leaves it out."""
    near_frames: int = 4
    """How many of these to draw from close to the mouth; 0 leaves it out."""

    def __post_init__(self) -> None:
        many = (0, 1_000_000)
        limits = {"frames": (1, 1_000_000), "geometry_frames": many, "near_frames": many}
        check_ranges(self, TrainingOptionError, **limits)


@dataclass(frozen=True, kw_only=True, slots=True)
class CaptureTruth:
    """What is known of a capture, made once for all its runs."""

    data: TrainingData
    frames: list[int]
    views: dict[tuple[int, str], TrueView]
    """True depth, empty where it is unknown or not asked for."""
    near: NearField | str
    """Pictures from close to the mouth, or why there are none."""
    tracked_mm: dict[str, float | None]
    """Depth error of the tracked mesh itself, by region; empty as `views`."""

    @property
    def identity(self) -> str:
        """Who was captured."""
        return self.data.capture.identity


def open_run(folder: Path, capture: Path | None = None) -> Run:
    """Read a run's checkpoint and what it was trained on; `capture` if it moved or nothing says it.

    Raises:
        CheckpointError: No checkpoint, a damaged one, one of another version, or no word of the
            capture.
    """
    state = read_checkpoint(folder / "checkpoint.pt")
    if capture is None:
        try:
            capture = Path(json.loads((folder / RUN_FILE).read_text())["capture"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise CheckpointError(
                f"{folder / RUN_FILE}: does not say which capture the run was trained on "
                f"({error}); name it with --capture"
            ) from error
    return Run(
        folder=folder,
        capture=capture,
        config=TrainConfig.from_json(json.loads(state["config"])),
        steps=int(state["step"]),
        weights=state["model"],
    )


def prepare(capture: Path, limits: EvalLimits) -> CaptureTruth:
    """Open a capture and draw its truth. GL contexts are released before it returns.

    Raises:
        CaptureError: It cannot be read, or has no test frames.
    """
    data = TrainingData(Capture.open(capture))
    whole = data.test_frames if limits.split == "test" else data.train_frames
    frames = spaced(whole, limits.frames)
    views: dict[tuple[int, str], TrueView] = {}
    tracked: dict[str, float | None] = {}
    some = spaced(frames, limits.geometry_frames)
    if some and data.capture.has_truth:
        views = true_views(data, some)
        tracked = tracked_errors(data, some, views).means_mm()
    near: NearField | str = NOT_ASKED
    if limits.near_frames:
        near = near_field(data, spaced(frames, limits.near_frames))
    return CaptureTruth(data=data, frames=frames, views=views, near=near, tracked_mm=tracked)


def build(run: Run, truth: CaptureTruth) -> AvatarModel:
    """The run's model with its weights.

    Raises:
        CheckpointError: The weights are of another model or another capture.
    """
    truth.data.meshes.use(run.config.mesh_source)
    model = run.config.model.build(face_prior(truth.data, run.variant))
    try:
        model.load_state_dict(run.weights)
    except RuntimeError as error:
        raise CheckpointError(
            f"{run.folder}: the checkpoint is not of a {run.variant!r} model of "
            f"{truth.data.capture.path}: {error}"
        ) from error
    return model.eval()


def measure(
    run: Run, truth: CaptureTruth, progress: Callable[[str], None]
) -> tuple[list[dict[str, Any]], dict[str, Any], list[ByteArray]]:
    """Measure a run by the paper's protocol, on its own encoder's latents.

    Returns:
        Rows of the tables, one for each view; what is known of the run: "distribution" {frame, mse}
        with means over the views that have the frame, "geometry" the mean depth error by region in
        millimetres, empty where the truth is unknown, "near" {mse, psnr_db, frames} or {skipped}
        with the reason; and truth and prediction side by side from close to the mouth, one picture
        for each frame.
    """
    data, model = truth.data, build(run, truth)
    cost = model.cost
    with Rasteriser.of(data.meshes.topology(model.topology)) as rasteriser:
        evaluator = ModelEvaluator(data, model, rasteriser)
        progress(f"{run.folder}: views")
        found = measure_views(evaluator, truth.frames)
        progress(f"{run.folder}: geometry")
        depth = DepthErrors()
        for (frame, view), true in truth.views.items():
            picture = evaluator.draw(evaluator.encode(frame), data.images.camera(frame, view))
            depth.add(true, picture.pixels, picture.depth_m)
        progress(f"{run.folder}: near field")
        near, pictures = _near(evaluator, truth.near)
    shared = {"identity": truth.identity, "variant": run.variant, "block": run.block}
    costs = {
        "parameters": cost.parameters,
        "macs": cost.per_object_multiply_adds,
        "macs_per_pixel": cost.per_pixel_multiply_adds,
        "steps": run.steps,
        "seed": run.config.seed,
    }
    rows = [{**shared, "view": view, **errors.row(), **costs} for view, errors in found.items()]
    distribution = []
    for frame in truth.frames:
        if each := [errors.mse[frame] for errors in found.values() if frame in errors.mse]:
            where = data.capture.frames[frame]
            mean = float(np.mean(each))
            distribution.append({"frame": f"{where.segment}/{where.name}", "mse": mean})
    result = {
        "run": str(run.folder),
        **shared,
        "seed": run.config.seed,
        "source": str(data.capture.info.get("source", run.capture.name)),
        "distribution": distribution,
        "geometry": depth.means_mm() if truth.views else {},
        "near": near,
    }
    return rows, result, pictures


def _near(
    evaluator: ModelEvaluator, near: NearField | str
) -> tuple[dict[str, Any], list[ByteArray]]:
    if isinstance(near, str):
        return {"skipped": near}, []
    errors: list[float] = []
    pictures: list[ByteArray] = []
    for frame, (camera, image) in near.items():
        picture = evaluator.draw(evaluator.encode(frame), camera)
        errors.append(mse(picture.colours, picture.within(image)))
        shown = picture.on(np.full_like(image, 128)).round().astype(np.uint8)
        pictures.append(np.concatenate([image, shown], axis=1))
    error = float(np.mean(errors))
    found = {"mse": error, "psnr_db": psnr_db(error), "frames": len(errors)}
    return found, pictures
