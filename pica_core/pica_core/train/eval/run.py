"""Finished runs, opened for evaluation, and everything that is measured of one.

Of synthetic captures more is known than images. Geometry is judged by depth: at each pixel of the
evaluation views that both the true and the decoded mesh cover, how far apart they lie along the
ray. Regions are those of the true mesh, so that all models are judged on the same pixels. Errors
are capped at `DEPTH_CAP_MM`: beyond, one of the two is another surface.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from pica_core.avatar.variants import VARIANTS
from pica_core.capture.dataset.dataset import Capture, CaptureFrame, Topology
from pica_core.errors import CheckpointError, TrainingOptionError, check_ranges
from pica_core.model.interface import AvatarModel
from pica_core.train.config import TrainConfig
from pica_core.train.data.prior import face_prior
from pica_core.train.data.training import TrainingData, spaced
from pica_core.train.eval.evaluate import ModelEvaluator, measure_views
from pica_core.train.raster import Rasteriser
from pica_core.train.train import read_checkpoint
from pica_core.types import ByteArray, Float64Array, FloatArray, Int64Array, IntArray

DEPTH_CAP_MM = 20.0
REGIONS = ("mouth", "eyes", "rest")
_REST = len(REGIONS) - 1
_NOTHING = 255


class TrueView(NamedTuple):
    """An image of the true mesh.

    Attributes:
        region: Index into `REGIONS`, 255 where nothing is, uint8 ``[H, W]``.
        depth_m: Along the camera's axis, 0 where nothing is, float32 ``[H, W]``.
    """

    region: ByteArray
    depth_m: FloatArray


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthErrors:
    """Absolute depth errors by region, summed up."""

    sums_mm: Float64Array = field(default_factory=lambda: np.zeros(len(REGIONS)))
    counts: Int64Array = field(default_factory=lambda: np.zeros(len(REGIONS), np.int64))

    def add(self, truth: TrueView, pixels: Int64Array, depth_m: FloatArray) -> None:
        """Count one image, given by its covered pixels and their depths."""
        region = truth.region.reshape(-1)[pixels]
        error_mm = 1000 * np.abs(depth_m - truth.depth_m.reshape(-1)[pixels])
        error_mm = np.minimum(error_mm, DEPTH_CAP_MM)
        self.sums_mm[:] += np.bincount(region, error_mm, _NOTHING + 1)[: len(REGIONS)]
        self.counts[:] += np.bincount(region, minlength=_NOTHING + 1)[: len(REGIONS)]

    def means_mm(self) -> dict[str, float | None]:
        """Mean error by region; None where nothing was seen of it."""
        return {
            name: float(self.sums_mm[index] / self.counts[index]) if self.counts[index] else None
            for index, name in enumerate(REGIONS)
        }


def true_views(data: TrainingData, frames: list[int]) -> dict[tuple[int, str], TrueView]:
    """The true mesh of frames from the evaluation views. Makes and releases a GL context."""
    capture, topology = data.capture, data.capture.topology
    region_of_face = np.full(len(topology.faces) + 1, _REST, np.uint8)
    for index in range(_REST - 1, -1, -1):  # a triangle is where one of its corners lies
        region_of_face[:-1][topology.region(REGIONS[index])[topology.faces].any(1)] = index
    region_of_face[-1] = _NOTHING
    drawn = _drawn(data, frames, topology, capture.true_vertices_m)
    return {place: TrueView(region_of_face[ids], depth_m) for place, ids, depth_m in drawn}


def tracked_errors(
    data: TrainingData, frames: list[int], truth: dict[tuple[int, str], TrueView]
) -> DepthErrors:
    """How far the tracked mesh itself lies from the truth. Makes and releases a GL context."""
    capture, errors = data.capture, DepthErrors()
    for place, ids, depth_m in _drawn(data, frames, capture.tracked_topology, capture.vertices_m):
        pixels = np.flatnonzero(ids >= 0)
        errors.add(truth[place], pixels, depth_m.reshape(-1)[pixels])
    return errors


def _drawn(
    data: TrainingData,
    frames: list[int],
    topology: Topology,
    vertices_of: Callable[[CaptureFrame], FloatArray],
) -> Iterator[tuple[tuple[int, str], IntArray, FloatArray]]:
    """Meshes of frames from the evaluation views: frame and view, triangles, depths in metres."""
    with Rasteriser.of(topology) as rasteriser:
        for frame in frames:
            vertices_m = vertices_of(data.capture.frames[frame])
            for name in data.images.evaluation_views:
                camera = data.images.camera(frame, name)
                ids = rasteriser.triangle_ids(vertices_m, camera)
                yield (frame, name), ids, rasteriser.batch_depths_m([camera])[0]


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
        return self.config.variant

    @property
    def block(self) -> str | None:
        """Block of its per-object decoders; None where there are none."""
        is_codec = VARIANTS[self.variant].network == "pixel_codec"
        return self.config.block if is_codec else None


@dataclass(frozen=True, kw_only=True, slots=True)
class EvalLimits:
    """How much to measure."""

    split: Literal["train", "test"] = "test"
    """Held-out frames, or for comparison those that were trained on."""
    frames: int = 25
    """How many of them, evenly spaced."""
    geometry_frames: int = 8
    """How many of these to compare the geometry of; 0 leaves it out."""

    def __post_init__(self) -> None:
        limits = {"frames": (1, 1_000_000), "geometry_frames": (0, 1_000_000)}
        check_ranges(self, TrainingOptionError, **limits)


@dataclass(frozen=True, kw_only=True, slots=True)
class CaptureTruth:
    """What is known of a capture, made once for all its runs."""

    data: TrainingData
    frames: list[int]
    views: dict[tuple[int, str], TrueView]
    """True depth, empty where it is unknown or not asked for."""
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
    state = read_checkpoint(folder)
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
        config=state["config"],
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
    return CaptureTruth(data=data, frames=frames, views=views, tracked_mm=tracked)


def build(run: Run, truth: CaptureTruth) -> AvatarModel:
    """The run's model with its weights.

    Raises:
        CheckpointError: The weights are of another model or another capture.
    """
    truth.data.meshes.use(run.config.mesh_source)
    model = run.config.build(face_prior(truth.data, run.variant))
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
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Measure a run by the paper's protocol, on its own encoder's latents.

    Returns:
        Rows of the tables, one for each view; what is known of the run: "distribution" {frame, mse}
        with means over the views that have the frame, "geometry" the mean depth error by region in
        millimetres, empty where the truth is unknown.
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
    }
    return rows, result
