"""What a synthetic capture knows and a real one does not: exact depth, and pictures from anywhere.

Geometry is judged by depth: at each pixel of the evaluation views that both the true and the
decoded mesh cover, how far apart they lie along the ray. Regions are those of the true mesh, so
that all models are judged on the same pixels. Errors are capped at `DEPTH_CAP_MM`: beyond, one of
the two is another surface (a silhouette, the back of the mouth), and how far that one lies says
nothing.

Near-field pictures are drawn from a place much closer to the mouth than any camera of the capture
(paper, Fig. "Rendering at a novel viewing position"); the truth is drawn by the stage itself.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pica_core.camera import Camera, look_at
from pica_core.capture.dataset.dataset import Capture, CaptureFrame, Topology
from pica_core.capture.person.choices import person_of
from pica_core.capture.person.subject import PersonSubject
from pica_core.train.data.training import TrainingData
from pica_core.train.rasterise import Rasteriser
from pica_core.types import ByteArray, Float64Array, FloatArray, Int64Array, IntArray

DEPTH_CAP_MM = 20.0
REGIONS = ("mouth", "eyes", "rest")
_REST = len(REGIONS) - 1
_NOTHING = 255
NOT_ASKED = "not asked for"
"""Why there is no near field, if none was wanted."""
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
    """Draw the truth of some frames close to the mouth, or return why that is impossible. Makes
    and releases a GL context."""
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
    """The capture's subject, or why it cannot be drawn."""
    capture = data.capture
    if "person" not in capture.info or not capture.has_truth:
        yield "this capture's subject cannot be drawn from a place without a camera"
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
