"""Find what is wrong with a capture: every file by name, size and header, some by their pixels.

What describes the capture comes first; if that cannot be read, each describing file is named and
the rest is left. Then every frame: meshes, poses, and headers of all images. Pixels are decoded for
some frames spread over the capture: there the projected mesh has to lie on the mask and depth on
the mesh (`check_geometry`).
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pica_core.capture.dataset import files, multiface
from pica_core.capture.dataset.check_geometry import depth_problem, silhouette_problem
from pica_core.capture.dataset.dataset import Capture, CaptureFrame
from pica_core.errors import CaptureError

Result = TypeVar("Result")

PIXEL_FRAMES = 16
"""Frames whose pixels are decoded, unless said otherwise (chosen)."""
MAX_PROBLEMS = 1000
"""Problems that are kept; more are only counted."""
HEAD_SIZE_M = (0.1, 2.0)
"""Diagonals of a head's bounding box that are believed: else units are wrong."""
EXPRESSION_RANGE = (-0.5, 1.6)
"""Expression values that are believed; recordings reach 1.05."""
SAME_EXPRESSION = 1e-4
"""Expressions that differ by less in every value are the same."""


@dataclass(slots=True)
class _Findings:
    """Problems so far."""

    root: Path
    problems: list[dict[str, str]] = field(default_factory=list)
    uncounted: int = 0

    def add(self, where: Path | str, what: str) -> None:
        if len(self.problems) >= MAX_PROBLEMS:
            self.uncounted += 1
            return
        text = str(where)
        if text.startswith(f"{self.root}{os.sep}"):
            text = text[len(str(self.root)) + 1 :]
        self.problems.append({"where": text, "what": what})

    def attempt(self, work: Callable[..., Result], *arguments: Any) -> Result | None:
        """What `work` returns; None where it fails, which is a problem then."""
        try:
            return work(*arguments)
        except CaptureError as error:
            self.add_error(str(error))
        except OSError as error:
            self.add(error.filename or self.root, error.strerror or str(error))
        return None

    def add_error(self, message: str) -> None:
        """A message that starts with the file."""
        where, _, what = message.partition(": ")
        self.add(where, what or message)


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
    findings = _Findings(directory)
    _check_leftovers(findings)
    result: dict[str, Any] = {"frames": 0, "cameras": 0, "images": 0, "decoded": 0}
    result["split"] = dict.fromkeys(files.SPLITS, 0)
    try:
        capture = Capture.open(directory)
    except CaptureError as error:
        _check_descriptions(findings, str(error))
    else:
        for problem in capture.left_out:
            findings.add_error(problem)
        _check_cameras(findings, capture)
        _check_tables(findings, capture)
        _check_split(findings, capture)
        result["cameras"] = len(capture.cameras)
        result["frames"] = len(capture.frames)
        result["split"] = {split: len(capture.frames_of(split)) for split in files.SPLITS}
        for frame in capture.frames:
            result["images"] += _check_frame(findings, capture, frame)
        for frame in files.spread_evenly(capture.frames, pixel_frames or len(capture.frames)):
            result["decoded"] += _check_pixels(findings, capture, frame)
    if findings.uncounted:
        findings.problems.append(
            {"where": str(directory), "what": f"{findings.uncounted} more problems"}
        )
    return {"ok": not findings.problems, "problems": findings.problems, **result}


def _check_leftovers(findings: _Findings) -> None:
    root = findings.root
    if (root / multiface.MARKER).exists():
        findings.add(root / multiface.MARKER, "the render is not finished; run it again to go on")
    for path in root.rglob("*.part"):
        findings.add(path, "a half-written file; an interrupted render leaves one")


def _check_descriptions(findings: _Findings, message: str) -> None:
    """Which describing files cannot be read, beside the first, whose message is given."""
    root = findings.root
    findings.add_error(message)
    first = findings.problems[-1]
    attempts: list[tuple[str, Callable[[Path], object]]] = [
        (multiface.CAPTURE, multiface.read_json),
        (multiface.KRT, lambda path: multiface.read_krt(path, 1, 1)),  # no matter of what size
        (multiface.TOPOLOGY, files.read_topology),
        (multiface.TRACKED_TOPOLOGY, files.read_topology),
        (multiface.EXPRESSIONS, files.read_expressions),
        (multiface.FRAME_LIST, files.read_frame_list),
    ]
    for name, read in attempts:
        if (root / name).exists() or name in (multiface.KRT, multiface.FRAME_LIST):
            before = len(findings.problems)
            findings.attempt(read, root / name)
            if findings.problems[before:] == [first]:
                del findings.problems[before:]


def _check_cameras(findings: _Findings, capture: Capture) -> None:
    krt = capture.path / multiface.KRT
    for camera in capture.cameras:
        k, r = camera.intrinsics, camera.rotation
        off = float(np.abs(r @ r.T - np.eye(3)).max())
        if off > 1e-3 or np.linalg.det(r) < 0:
            findings.add(krt, f"camera {camera.name}: not a rotation (off by {off:.2g})")
        if k[0, 0] <= 0 or k[1, 1] <= 0 or abs(k[2, 2] - 1) > 1e-6:
            findings.add(krt, f"camera {camera.name}: focal lengths {k[0, 0]:g}, {k[1, 1]:g}")
        elif not (0 < k[0, 2] < camera.width and 0 < k[1, 2] < camera.height):
            at, size = f"{k[0, 2]:g}, {k[1, 2]:g}", f"{camera.width}x{camera.height}"
            findings.add(krt, f"camera {camera.name}: principal point {at} outside of {size}")


def _check_tables(findings: _Findings, capture: Capture) -> None:
    root, described = capture.path, capture.path / multiface.CAPTURE
    listed = {(frame.segment, frame.name) for frame in capture.frames}
    for folder in sorted((root / "tracked_mesh").glob("*")):
        names = [path.stem for path in folder.glob("*.bin")]
        extra = sum((folder.name, name) not in listed for name in names)
        known = sum(problem.startswith(f"{folder}{os.sep}") for problem in capture.left_out)
        if extra > known:
            findings.add(folder, f"{extra - known} meshes of frames that are not listed")
    if capture.is_published:
        return
    stated, num_vertices = capture.info.get("num_vertices"), len(capture.topology.vertex_uv)
    if stated != num_vertices:
        problem = f"num_vertices is {stated!r}, the topology has {num_vertices}"
        findings.add(described, problem)
    split = capture.info.get("split")
    if not isinstance(split, dict):
        findings.add(described, f"split is {split!r:.40}; a map is needed")
        return
    for name in files.SPLITS:
        found = {frame.segment for frame in capture.frames_of(name)}
        told = split.get(name, [])
        if not isinstance(told, list) or not found <= {str(segment) for segment in told}:
            problem = f"split {name!r} does not hold the segments of {multiface.EXPRESSIONS}"
            findings.add(described, problem)
    for frame in capture.frames:
        values = capture.arkit(frame)
        if values.min() < EXPRESSION_RANGE[0] or values.max() > EXPRESSION_RANGE[1]:
            span = f"values from {values.min():g} to {values.max():g}"
            findings.add(root / multiface.EXPRESSIONS, f"{frame.segment} {frame.name}: {span}")


def _check_split(findings: _Findings, capture: Capture) -> None:
    """Segments, expressions or meshes that are in both splits."""
    train, test = (capture.frames_of(split) for split in files.SPLITS)
    for split, frames in (("train", train), ("test", test)):
        if not frames:
            findings.add(capture.path, f"no frame is for {split}ing")
    shared = {frame.segment for frame in train} & {frame.segment for frame in test}
    for segment in sorted(shared):
        findings.add(segment, "the segment is in both splits")

    def key(frame: CaptureFrame) -> bytes:
        if capture.has_expressions:
            rounded = np.rint(capture.arkit(frame) / SAME_EXPRESSION)
            return bytes(rounded.astype(np.int64))
        return (capture.path / multiface.mesh_path(frame.segment, frame.name)).read_bytes()

    def compare() -> None:
        known = {key(frame): frame for frame in train}
        for frame in test:
            twin = known.get(key(frame))
            if twin is not None:
                problem = f"the same expression is for training in {twin.segment} {twin.name}"
                findings.add(f"{frame.segment} {frame.name}", problem)

    findings.attempt(compare)


def _check_frame(findings: _Findings, capture: Capture, frame: CaptureFrame) -> int:
    """Everything about a frame but pixels; returns how many images there are."""
    root = capture.path
    read = [capture.vertices_m] + ([capture.true_vertices_m] if capture.has_truth else [])
    for number, vertices_of in enumerate(read):
        vertices = findings.attempt(vertices_of, frame)
        if vertices is None:
            continue
        size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
        if not HEAD_SIZE_M[0] <= size <= HEAD_SIZE_M[1]:
            kind = "tracked_mesh" if number == 0 else multiface.TRUTH_MESH
            path = multiface.mesh_path(frame.segment, frame.name, kind)
            findings.add(root / path, f"the mesh is {size:.3g} m large; are its units mm?")
    pose = findings.attempt(capture.head_to_world, frame)
    if pose is not None and np.abs(pose[:, :3] @ pose[:, :3].T - np.eye(3)).max() > 1e-3:
        path = multiface.transform_path(frame.segment, frame.name)
        findings.add(root / path, "not a rotation")
    side = capture.texture_size
    texture = root / multiface.texture_path(side, frame.segment, frame.name)
    findings.attempt(files.check_image_header, texture, "RGB", (side, side))
    kinds = [("images", "RGB")]
    kinds += [("mask", "L")] if capture.has_masks else []
    kinds += [(multiface.TRUTH_DEPTH, "I;16")] if capture.has_truth else []
    kinds += [("depth", "I;16")] if capture.has_depth_of(frame) else []
    present = capture.cameras_of(frame)
    if not present:
        findings.add(f"{frame.segment} {frame.name}", "no camera has an image of the frame")
    for camera in capture.cameras:
        if capture.is_published and camera.name not in present:
            continue  # published captures miss frames of single cameras
        for kind, mode in kinds:
            path = root / multiface.image_path(kind, frame.segment, camera.name, frame.name)
            findings.attempt(files.check_image_header, path, mode, (camera.width, camera.height))
    return len(present)


def _check_pixels(findings: _Findings, capture: Capture, frame: CaptureFrame) -> int:
    """Decode a frame's images and compare them with its mesh; returns how many were decoded."""
    vertices = findings.attempt(capture.vertices_m, frame)
    findings.attempt(capture.average_texture, frame)

    def add(kind: str, name: str, problem: str | None) -> None:
        if problem:
            path = multiface.image_path(kind, frame.segment, name, frame.name)
            findings.add(capture.path / path, problem)

    def compare(name: str) -> None:
        if np.ptp(capture.image(frame, name)) == 0:
            add("images", name, "the image has one colour only")
        mask = capture.mask(frame, name) if capture.has_masks else None
        if vertices is None:
            return
        camera = capture.head_camera(frame, name)
        faces = capture.tracked_topology.faces
        kind = "mask" if capture.has_masks else "images"
        add(kind, name, silhouette_problem(camera, vertices, faces, mask))
        if capture.has_truth:
            exact, depth = capture.true_vertices_m(frame), capture.true_depth_m(frame, name)
            problem = depth_problem(camera, exact, capture.topology.faces, depth)
            add(multiface.TRUTH_DEPTH, name, problem)
        if capture.has_depth_of(frame):
            problem = depth_problem(camera, vertices, faces, capture.depth_m(frame, name))
            add("depth", name, problem)

    present = capture.cameras_of(frame)
    for name in present:
        before = len(findings.problems)
        findings.attempt(compare, name)
        # A header that is bad was told of before.
        told = findings.problems[:before]
        findings.problems[before:] = [p for p in findings.problems[before:] if p not in told]
    return len(present)
