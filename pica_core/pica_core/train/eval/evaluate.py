"""Held-out error by the paper's protocol, at the size of one table row per view.

MSE is on 0-255 values over the rasterised pixels of the decoded mesh, on frames that training never
saw, averaged over frames (paper, section 6). PSNR and SSIM are means over frames of the same
pixels. `temporal_mse` is the error of the change from a frame to the next one of its take: flicker,
which a mean over single frames does not show.

Intervals are 95 % bootstrap intervals over test frames.
"""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from torch import Tensor

from pica_core.errors import CaptureError
from pica_core.train.data.sampler import spaced
from pica_core.train.data.training import TrainingData
from pica_core.train.eval.metrics import bootstrap_interval, change_mse, mse, psnr_db, ssim
from pica_core.train.eval.model_evaluator import ModelEvaluator, Picture
from pica_core.train.loop import Trainer
from pica_core.types import FloatArray

Source = Literal["encoder", "driver"]


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewErrors:
    """What was measured in one view, a value for each frame."""

    mse: dict[int, float] = field(default_factory=dict)
    """Errors keyed by frame: a view may lack some."""
    ssim: list[float] = field(default_factory=list)
    change_mse: list[float] = field(default_factory=list)
    """One for each frame whose successor is of the same take and split, and was not left out."""
    unreadable: list[int] = field(default_factory=list)
    """Frames whose image cannot be read; no error knows of them."""

    def row(self) -> dict[str, Any]:
        """Means, with the interval of the first."""
        errors = list(self.mse.values())
        low, high = bootstrap_interval(errors)
        return {
            "mse": float(np.mean(errors)),
            "mse_low": low,
            "mse_high": high,
            "psnr_db": float(np.mean([psnr_db(value) for value in errors])),
            "ssim": float(np.mean(self.ssim)),
            "temporal_mse": float(np.mean(self.change_mse)) if self.change_mse else None,
            "frames": len(errors),
            "unreadable": len(self.unreadable),
        }


def successor(data: TrainingData, frame: int) -> int | None:
    """The frame that follows directly in the same take, if there is one of the same split and it is
    not left out."""
    frames = data.capture.frames
    if frame + 1 >= len(frames):
        return None
    now, after = frames[frame], frames[frame + 1]
    wanted = now.listed + 1, now.segment, now.split
    return frame + 1 if (after.listed, after.segment, after.split) == wanted else None


def measure_views(
    evaluator: ModelEvaluator, frames: list[int], source: Source = "encoder"
) -> dict[str, ViewErrors]:
    """Draw frames from all evaluation views, and measure.

    Args:
        source: Whose latents: the model's own encoder's, as in the paper, or what a live sender
            makes of ARKit values.

    Returns:
        Errors by view, of those views that have a readable image of any of the frames.

    Raises:
        CaptureError: No view has one.
    """
    data = evaluator.data
    found = {view: ViewErrors() for view in data.images.evaluation_views}
    for frame in frames:
        after = successor(data, frame)
        latent = _latent(evaluator, source, frame)
        later = None if after is None else _latent(evaluator, source, after)
        for view in data.images.evaluation_views_of(frame):
            errors = found[view]
            camera, image = data.images.camera(frame, view), data.images.readable(frame, view)
            if image is None:
                errors.unreadable.append(frame)
                continue
            picture = evaluator.draw(latent, camera)
            seen = picture.within(image)
            errors.mse[frame] = mse(picture.colours, seen)
            laid = picture.on(image)
            errors.ssim.append(ssim(laid, image, picture.covered(camera)))
            if after is None or later is None or view not in data.images.cameras_of(after):
                continue
            if (next_image := data.images.readable(after, view)) is not None:
                second_camera = data.images.camera(after, view)
                second = evaluator.draw(later, second_camera)
                change = _change(picture, second, seen, second.within(next_image))
                errors.change_mse.append(change)
    measured = {view: errors for view, errors in found.items() if errors.mse}
    if not measured:
        raise CaptureError(f"{data.capture.path}: no image to measure on can be read")
    return measured


def evaluate(trainer: Trainer, *, max_frames: int = 25) -> list[dict[str, Any]]:
    """Evaluate a run on evenly spaced test frames, from the capture's evaluation views.

    Returns:
        Rows of {source, view, mse, mse_low, mse_high, psnr_db, ssim, temporal_mse, frames,
        unreadable, vertex_error_mm, lid_error_mm, lip_error_mm}: "encoder" rows use the model's own
        encoder, "driver" rows the expression encoder, which is what a live sender runs;
        `unreadable` counts frames that were left out. The vertex errors are mean distances from the
        capture's mesh that the model was trained on; None where it does not name the region.

    Raises:
        CaptureError: No image can be read.
    """
    data = trainer.data
    evaluator = ModelEvaluator(data, trainer.model, trainer.rasteriser)
    frames = spaced(data.test_frames, max_frames)
    topology = data.meshes.topology(trainer.model.topology)
    sources: list[Source] = ["encoder", "driver"] if data.capture.has_expressions else ["encoder"]
    rows: list[dict[str, Any]] = []
    for source in sources:
        off_mm = np.mean([_vertex_errors_mm(evaluator, source, frame) for frame in frames], axis=0)
        distances: dict[str, float | None] = {"vertex_error_mm": float(off_mm.mean())}
        for name in ("lid", "lip"):
            part = off_mm[topology.region(f"{name}s")]
            distances[f"{name}_error_mm"] = float(part.mean()) if len(part) else None
        for view, errors in measure_views(evaluator, frames, source).items():
            rows.append({"source": source, "view": view, **errors.row(), **distances})
    return rows


def mean_mse(rows: list[dict[str, Any]], source: str = "encoder") -> float | None:
    """The mean over views of one source's MSE; None where it was not measured."""
    errors = [row["mse"] for row in rows if row["source"] == source]
    return float(np.mean(errors)) if errors else None


def _latent(evaluator: ModelEvaluator, source: Source, frame: int) -> Tensor:
    return evaluator.encode(frame) if source == "encoder" else evaluator.drive(frame)


def _vertex_errors_mm(evaluator: ModelEvaluator, source: Source, frame: int) -> FloatArray:
    """How far each vertex of a frame is off, ``[V]``."""
    meshes, is_tracked = evaluator.data.meshes, evaluator.model.topology == "tracked"
    wanted = meshes.true_at_tracked(frame) if is_tracked else meshes.dense_m[frame]
    found = evaluator.vertices_m(_latent(evaluator, source, frame))
    off_mm: FloatArray = 1000 * np.linalg.norm(found - wanted, axis=1)
    return off_mm


def _change(
    first: Picture, second: Picture, seen_first: FloatArray, seen_second: FloatArray
) -> float:
    """Error of the change, over the pixels that both pictures cover."""
    _, before, after = np.intersect1d(
        first.pixels, second.pixels, assume_unique=True, return_indices=True
    )
    return change_mse(
        (first.colours[before], second.colours[after]), (seen_first[before], seen_second[after])
    )
