"""Finished runs, opened for evaluation, and everything that is measured of one.

Of synthetic captures more is known than images. Geometry is judged by depth: at each pixel of the
evaluation views that both the true and the decoded mesh cover, how far apart they lie along the
ray. Regions are those of the true mesh, so that all models are judged on the same pixels. Errors
are capped at `DEPTH_CAP_MM`: beyond, one of the two is another surface. Near-field pictures are
drawn from a place much closer to the mouth than any camera of the capture (paper, Fig. "Rendering
at a novel viewing position"); the truth is drawn by the stage itself.
"""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from pica_core.avatar.variants import VARIANTS
from pica_core.camera import Camera, look_at
from pica_core.capture.dataset.dataset import Capture, CaptureFrame, Topology
from pica_core.capture.person.choices import person_of
from pica_core.capture.person.subject import PersonSubject
from pica_core.errors import CheckpointError, TrainingOptionError, check_ranges
from pica_core.model.interface import AvatarModel
from pica_core.train.config import TrainConfig
from pica_core.train.data.prior import face_prior
from pica_core.train.data.training import TrainingData, spaced
from pica_core.train.eval.evaluate import ModelEvaluator, measure_views, mse, psnr_db
from pica_core.train.raster import Rasteriser
from pica_core.train.train import read_checkpoint
from pica_core.types import ByteArray, Float64Array, FloatArray, Int64Array, IntArray

DEPTH_CAP_MM = 20.0
REGIONS = ("mouth", "eyes", "rest")
_REST = len(REGIONS) - 1
_NOTHING = 255
NOT_ASKED = "not asked for"
"""Why there is no near field, if nobody wanted one."""
NEAR_DISTANCE_M = 0.12
"""Distance of the camera from the lips (chosen: at 18 cm the paper's user sees the face fill the
screen)."""
NEAR_DIRECTION = (0.25, -0.12, 1.0)
"""Direction of the camera from the lips, head frame: a little sideways, so that depth shows."""
NEAR_FOV = 0.85
NEAR_SIZE_PX = 256
NearField = dict[int, tuple[Camera, ByteArray]]
"""True pictures from close to the mouth, by frame: the camera in head axes and what it sees, uint8
``[H, W, 3]``."""
SAME_PICTURE = 1.0
"""Mean difference on 0-255 up to which the stage is taken to draw what the capture holds (files
hold 8 bits and three decimals)."""


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


def near_camera(capture: Capture, vertices_m: FloatArray) -> Camera:
    """A camera close to the mouth of a mesh on the capture's topology, in head axes."""
    lips = capture.topology.regions.get("lips", capture.topology.regions.get("mouth"))
    assert lips is not None
    target = vertices_m[lips].mean(0).astype(np.float64)
    direction = np.array(NEAR_DIRECTION) / np.linalg.norm(NEAR_DIRECTION)
    return look_at(
        name="near",
        centre_m=target + NEAR_DISTANCE_M * direction,
        target_m=target,
        vertical_fov=NEAR_FOV,
        width=NEAR_SIZE_PX,
        height=NEAR_SIZE_PX,
    )


def near_field(data: TrainingData, frames: list[int]) -> NearField | str:
    """Draw the truth of some frames close to the mouth, or say why nobody can. Makes and releases a
    GL context."""
    capture = data.capture
    if not {"lips", "mouth"} & set(capture.topology.regions):
        return "the capture's topology names no lips"
    images: NearField = {}
    with _on_stage(data, frames[0]) as subject:
        if isinstance(subject, str):
            return subject
        for frame in frames:
            vertices_m = subject.pose(capture.arkit(capture.frames[frame]))
            camera = near_camera(capture, vertices_m)
            images[frame] = camera, subject.draw(camera).image
    return images


@contextmanager
def _on_stage(data: TrainingData, frame: int) -> Iterator[PersonSubject | str]:
    """The capture's subject, or why nobody can draw it."""
    capture = data.capture
    if "person" not in capture.info or not capture.has_truth:
        yield "nobody can draw this capture's subject from a place without a camera"
        return
    subject = PersonSubject(person_of(capture.info["person"]))
    try:
        views = data.images.evaluation_views_of(frame)
        view, image = data.images.first_readable(frame, views)
        subject.pose(capture.arkit(capture.frames[frame]))
        drawn = subject.draw(data.images.camera(frame, view)).image.astype(np.float64)
        difference = float(np.abs(drawn - image).mean())
        if difference <= SAME_PICTURE:
            yield subject
        else:
            yield (
                f"the stage no longer draws what the capture holds: {difference:.1f} of 255 apart "
                "on average"
            )
    finally:
        subject.release()


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
