"""Find what is wrong with a capture, by names, sizes and headers of its files.

The files that describe the capture come first; where one cannot be read it is named and the rest is
left. Then every frame: meshes, poses, headers of all images, and whether cameras see the mesh.
Pixels are not decoded.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pica_core.camera import Camera
from pica_core.capture.dataset import files, multiface
from pica_core.capture.dataset.dataset import Capture, CaptureFrame
from pica_core.errors import CaptureError
from pica_core.types import Float64Array, FloatArray

LEAST_INSIDE = 0.03
"""Share of the vertices that a camera of the capture sees at least."""
HEAD_SIZE_M = (0.1, 4.0)
"""Diagonals of a head's bounding box that are believed: else units are wrong."""
EXPRESSION_RANGE = (-0.5, 1.6)
"""Expression values that are believed; recordings reach 1.05."""
Result = TypeVar("Result")


def check_capture(directory: Path) -> dict[str, Any]:
    """Check a capture directory.

    Returns:
        ``ok`` (bool), ``problems`` (list of maps with ``where`` and ``what``), ``frames``,
        ``cameras``, ``images``, ``split`` (frames by split).

    Raises:
        CaptureError: There is no such directory.
    """
    if not directory.is_dir():
        raise CaptureError(f"{directory}: no such directory")
    check = _Check(directory)
    result: dict[str, Any] = {"frames": 0, "cameras": 0, "images": 0}
    result["split"] = dict.fromkeys(files.SPLITS, 0)
    if (capture := check.attempt(Capture.open, directory)) is not None:
        for problem in capture.left_out:
            check.add_error(problem)
        check.cameras(capture)
        check.split(capture)
        result["cameras"] = len(capture.cameras)
        result["frames"] = len(capture.frames)
        result["split"] = {split: len(capture.frames_of(split)) for split in files.SPLITS}
        result["images"] = sum(check.frame(capture, frame) for frame in capture.frames)
    problems = [{"where": where, "what": what} for where, what in check.problems]
    return {"ok": not problems, "problems": problems, **result}


class _Check:
    """Gathers the problems of one directory.

    Attributes:
        problems: Place and description of each problem, reported once.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.problems: dict[tuple[str, str], None] = {}
        if (root / multiface.MARKER).exists():
            self.add(multiface.MARKER, "the render is not finished; run it again to go on")
        for path in root.rglob("*.part"):
            self.add(path, "a half-written file; an interrupted render leaves one")

    def add(self, where: Path | str, what: str) -> None:
        """Note a problem."""
        self.problems[str(where).removeprefix(f"{self.root}{os.sep}"), what] = None

    def add_error(self, message: str) -> None:
        """Note a message that starts with the file."""
        where, _, what = message.partition(": ")
        self.add(where, what or message)

    def attempt(self, work: Callable[..., Result], *arguments: Any) -> Result | None:
        """What `work` returns; None where it fails, which is a problem then."""
        try:
            return work(*arguments)
        except CaptureError as error:
            self.add_error(str(error))
        except OSError as error:
            self.add(error.filename or self.root, error.strerror or str(error))
        return None

    def cameras(self, capture: Capture) -> None:
        for camera in capture.cameras:
            k, name = camera.intrinsics, f"camera {camera.name}"
            if not _is_rotation(camera.rotation):
                self.add(multiface.KRT, f"{name}: not a rotation")
            if k[0, 0] <= 0 or k[1, 1] <= 0 or abs(k[2, 2] - 1) > 1e-6:
                self.add(multiface.KRT, f"{name}: focal lengths {k[0, 0]:g}, {k[1, 1]:g}")
            elif not (0 < k[0, 2] < camera.width and 0 < k[1, 2] < camera.height):
                at, size = f"{k[0, 2]:g}, {k[1, 2]:g}", f"{camera.width}x{camera.height}"
                self.add(multiface.KRT, f"{name}: principal point {at} outside of {size}")

    def split(self, capture: Capture) -> None:
        """Splits without frames, and segments that are in both."""
        train, test = (capture.frames_of(split) for split in files.SPLITS)
        for split, frames in (("train", train), ("test", test)):
            if not frames:
                self.add(capture.path, f"no frame is for {split}ing")
        for segment in sorted({each.segment for each in train} & {each.segment for each in test}):
            self.add(segment, "the segment is in both splits")

    def frame(self, capture: Capture, frame: CaptureFrame) -> int:
        """Everything about a frame; returns how many images there are."""
        place, name = (frame.segment, frame.name), f"{frame.segment} {frame.name}"
        if capture.has_expressions:
            low, high = capture.arkit(frame).min(), capture.arkit(frame).max()
            if low < EXPRESSION_RANGE[0] or high > EXPRESSION_RANGE[1]:
                self.add(multiface.EXPRESSIONS, f"{name}: values from {low:g} to {high:g}")
        vertices = self.attempt(capture.vertices_m, frame)
        meshes = {"tracked_mesh": vertices}
        if capture.has_truth:
            meshes[multiface.TRUTH_MESH] = self.attempt(capture.true_vertices_m, frame)
        for kind, found in meshes.items():
            size = HEAD_SIZE_M[0] if found is None else float(np.linalg.norm(np.ptp(found, axis=0)))
            if not HEAD_SIZE_M[0] <= size <= HEAD_SIZE_M[1]:
                what = f"the mesh is {size:.3g} m large; are its units mm?"
                self.add(multiface.mesh_path(*place, kind), what)
        pose = self.attempt(capture.head_to_world, frame)
        if pose is not None and not _is_rotation(pose[:, :3]):
            self.add(multiface.transform_path(*place), "not a rotation")
        side = capture.texture_size
        texture = capture.path / multiface.texture_path(side, *place)
        self.attempt(files.check_image_header, texture, "RGB", (side, side))
        kinds = [("images", "RGB")]
        kinds += [("depth", "I;16")] if capture.has_depth else []
        present = capture.cameras_of(frame)
        if not present:
            self.add(name, "no camera has an image of the frame")
        for camera in capture.cameras:
            if capture.is_published and camera.name not in present:
                continue  # published captures miss frames of single cameras
            for kind, mode in kinds:
                image = multiface.image_path(kind, frame.segment, camera.name, frame.name)
                size_px = camera.width, camera.height
                self.attempt(files.check_image_header, capture.path / image, mode, size_px)
            if vertices is not None and pose is not None:
                seen = _share_seen(camera.in_head(pose), vertices)
                if seen < LEAST_INSIDE:
                    what = f"camera {camera.name} sees {seen:.1%} of the mesh"
                    self.add(multiface.KRT, what)
        return len(present)


def _is_rotation(matrix: Float64Array) -> bool:
    off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    return off < 1e-3 and np.linalg.det(matrix) > 0


def _share_seen(camera: Camera, vertices_m: FloatArray) -> float:
    """Share of a mesh's vertices that lie in the picture of a camera in head axes."""
    pixels, distance = camera.project(vertices_m)
    inside = (distance > 0) & (pixels >= 0).all(axis=1)
    return float((inside & (pixels < [camera.width, camera.height]).all(axis=1)).mean())
