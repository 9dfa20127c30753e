"""Find what is wrong with a capture: every file by name, size and header, some by their pixels.

The files that describe the capture come first; where one cannot be read it is named and the rest is
left. Then every frame: meshes, poses, and headers of all images. Pixels are decoded for some frames
spread over the capture: there the projected mesh has to lie on what is seen.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.ndimage import maximum_filter

from pica_core.camera import Camera
from pica_core.capture.dataset import files, multiface
from pica_core.capture.dataset.dataset import Capture, CaptureFrame
from pica_core.capture.triangles import vertex_normals
from pica_core.errors import CaptureError
from pica_core.types import Float64Array, FloatArray, Int64Array, IntArray

MOST_OUTSIDE = 0.02
"""Share of the vertices that face the camera, in the picture, that may lie beside the head."""
LEAST_INSIDE = 0.03
"""Share of the vertices that a camera of the capture sees at least."""
DEPTH_TOLERANCE_M = 0.01
"""How far depth may be from the mesh."""
MOST_IN_FRONT = 0.05
"""Share of the vertices that may lie before what is seen there."""
LEAST_ON_SURFACE = 0.2
"""Share of the vertices that face the camera and have to lie on what is seen there; seen from
below, long hair hides so much that 0.29 is left."""


def view_problem(
    camera: Camera, vertices_m: FloatArray, faces: IntArray, depth_m: FloatArray | None
) -> str | None:
    """What is wrong with where a camera in head axes sees a mesh, None if nothing.

    Depth ``[H, W]`` is 0 where the background is; None where it is not known.
    """
    pixels, distance = camera.project(vertices_m)
    if (distance <= 0).mean() > 0.5:
        return "the mesh lies behind the camera"
    row, _, _ = _inside(camera, pixels, distance)
    if len(row) < LEAST_INSIDE * len(vertices_m):
        return f"{len(row) / len(vertices_m):.1%} of the mesh lies in the picture"
    if depth_m is None:
        return None
    # An open mesh covers nothing from within, such as a collar from below.
    facing = _facing(camera, vertices_m, faces)
    row, column, _ = _inside(camera, pixels[facing > 0], distance[facing > 0])
    wide = maximum_filter(depth_m > 0, 2 * max(2, round(0.01 * min(depth_m.shape))) + 1)
    outside = float((~wide[row, column]).mean()) if len(row) else 0.0
    if outside > MOST_OUTSIDE:
        return f"{outside:.1%} of the mesh in the picture lies beside the head"
    row, column, at = _inside(camera, pixels[facing > 0.5], distance[facing > 0.5])
    seen = depth_m[row, column]
    known = seen > 0
    if known.sum() < 20:
        return None  # too little to say
    behind = at[known] - seen[known]
    tolerance = DEPTH_TOLERANCE_M + 2 * at[known] / camera.intrinsics[0, 0]
    in_front = float((behind < -tolerance).mean())
    if in_front > MOST_IN_FRONT:
        return f"{in_front:.1%} of the mesh lies before the depth that is seen there"
    on_surface = float((np.abs(behind) <= tolerance).mean())
    if on_surface < LEAST_ON_SURFACE:
        return f"{on_surface:.1%} of the mesh lies on the depth that is seen there"
    return None


def _inside(
    camera: Camera, pixels: Float64Array, distance: Float64Array
) -> tuple[Int64Array, Int64Array, Float64Array]:
    """Row, column and distance of the points that are in the picture."""
    inside = (distance > 0) & (pixels >= 0).all(axis=1)
    inside &= (pixels < [camera.width, camera.height]).all(axis=1)
    column, row = np.floor(pixels[inside]).astype(np.int64).T
    return row, column, distance[inside]


def _facing(camera: Camera, vertices_m: FloatArray, faces: IntArray) -> Float64Array:
    """Cosine between each vertex's normal and its way to the camera."""
    normal = vertex_normals(vertices_m, faces)
    way = camera.centre_m - vertices_m
    return (normal * way).sum(axis=1) / np.linalg.norm(way, axis=1)


Result = TypeVar("Result")

PIXEL_FRAMES = 16
"""Frames whose pixels are decoded, unless said otherwise (chosen)."""
HEAD_SIZE_M = (0.1, 4.0)
"""Diagonals of a head's bounding box that are believed: else units are wrong."""
EXPRESSION_RANGE = (-0.5, 1.6)
"""Expression values that are believed; recordings reach 1.05."""


def check_capture(directory: Path, pixel_frames: int = PIXEL_FRAMES) -> dict[str, Any]:
    """Check a capture directory; of `pixel_frames` frames pixels are decoded, of all if 0.

    Returns:
        ``ok`` (bool), ``problems`` (list of maps with ``where`` and ``what``), ``frames``,
        ``cameras``, ``images``, ``split`` (frames by split), ``decoded`` (images whose pixels were
        looked at).

    Raises:
        CaptureError: There is no such directory.
    """
    if not directory.is_dir():
        raise CaptureError(f"{directory}: no such directory")
    check = _Check(directory)
    result: dict[str, Any] = {"frames": 0, "cameras": 0, "images": 0, "decoded": 0}
    result["split"] = dict.fromkeys(files.SPLITS, 0)
    if (capture := check.attempt(Capture.open, directory)) is not None:
        for problem in capture.left_out:
            check.add_error(problem)
        check.cameras(capture)
        check.split(capture)
        result["cameras"] = len(capture.cameras)
        result["frames"] = len(capture.frames)
        result["split"] = {split: len(capture.frames_of(split)) for split in files.SPLITS}
        for frame in capture.frames:
            result["images"] += check.frame(capture, frame)
        for frame in files.spread_evenly(capture.frames, pixel_frames or len(capture.frames)):
            result["decoded"] += check.pixels(capture, frame)
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

    def add(self, where: Path | str, what: str | None) -> None:
        """Note a problem, if there is one."""
        if what:
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
            k, r, name = camera.intrinsics, camera.rotation, f"camera {camera.name}"
            off = float(np.abs(r @ r.T - np.eye(3)).max())
            if off > 1e-3 or np.linalg.det(r) < 0:
                self.add(multiface.KRT, f"{name}: not a rotation (off by {off:.2g})")
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
        """Everything about a frame but pixels; returns how many images there are."""
        place = frame.segment, frame.name
        if capture.has_expressions:
            values = capture.arkit(frame)
            if values.min() < EXPRESSION_RANGE[0] or values.max() > EXPRESSION_RANGE[1]:
                span = f"values from {values.min():g} to {values.max():g}"
                self.add(multiface.EXPRESSIONS, f"{frame.segment} {frame.name}: {span}")
        meshes = {"tracked_mesh": capture.vertices_m}
        if capture.has_truth:
            meshes[multiface.TRUTH_MESH] = capture.true_vertices_m
        for kind, vertices_of in meshes.items():
            if (vertices := self.attempt(vertices_of, frame)) is not None:
                size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
                if not HEAD_SIZE_M[0] <= size <= HEAD_SIZE_M[1]:
                    what = f"the mesh is {size:.3g} m large; are its units mm?"
                    self.add(multiface.mesh_path(*place, kind), what)
        pose = self.attempt(capture.head_to_world, frame)
        if pose is not None and np.abs(pose[:, :3] @ pose[:, :3].T - np.eye(3)).max() > 1e-3:
            self.add(multiface.transform_path(*place), "not a rotation")
        side = capture.texture_size
        texture = capture.path / multiface.texture_path(side, *place)
        self.attempt(files.check_image_header, texture, "RGB", (side, side))
        kinds = [("images", "RGB")]
        kinds += [("mask", "L")] if capture.has_masks else []
        kinds += [("depth", "I;16")] if capture.has_depth else []
        present = capture.cameras_of(frame)
        if not present:
            self.add(f"{frame.segment} {frame.name}", "no camera has an image of the frame")
        for camera in capture.cameras:
            if capture.is_published and camera.name not in present:
                continue  # published captures miss frames of single cameras
            for kind, mode in kinds:
                image = multiface.image_path(kind, frame.segment, camera.name, frame.name)
                size_px = camera.width, camera.height
                self.attempt(files.check_image_header, capture.path / image, mode, size_px)
        return len(present)

    def pixels(self, capture: Capture, frame: CaptureFrame) -> int:
        """Decode a frame's images and compare them with its mesh; returns how many were decoded."""
        read, faces = capture.vertices_m, capture.tracked_topology.faces
        if capture.has_truth:
            read, faces = capture.true_vertices_m, capture.topology.faces
        vertices = self.attempt(read, frame)
        self.attempt(capture.average_texture, frame)

        def add(kind: str, name: str, problem: str | None) -> None:
            self.add(multiface.image_path(kind, frame.segment, name, frame.name), problem)

        def compare(name: str) -> None:
            if np.ptp(capture.image(frame, name)) == 0:
                add("images", name, "the image has one colour only")
            depth = capture.depth_m(frame, name) if capture.has_depth else None
            shown = capture.mask(frame, name) > 0 if capture.has_masks else None
            if shown is not None and depth is not None and (shown != (depth > 0)).any():
                add("mask", name, "the mask is not where depth is")
            kind = "images" if depth is None else "depth"
            camera = capture.head_camera(frame, name)
            if vertices is not None:
                add(kind, name, view_problem(camera, vertices, faces, depth))

        present = capture.cameras_of(frame)
        for name in present:
            self.attempt(compare, name)
        return len(present)
