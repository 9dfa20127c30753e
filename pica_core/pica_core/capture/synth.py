"""Render a subject on the stage into a capture directory.

Files are written aside and renamed; `capture.json` comes last, so a directory with one is
finished. A render that was interrupted goes on where it stopped: a frame counts as done when its
tracked mesh, the last of its files, is there. The same options give the same bytes on the same GL
driver.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from pica_core.arkit import ARKIT_NAMES
from pica_core.capture import multiface
from pica_core.capture.dataset import Topology
from pica_core.capture.expressions import Take, sample_takes
from pica_core.capture.gpu import BAKE_SIZE
from pica_core.capture.stage import EVALUATION_VIEWS, dome_cameras
from pica_core.capture.subject import HeadSubject, Subject
from pica_core.errors import CaptureError

ByteArray = npt.NDArray[np.uint8]
Progress = Callable[[int, int], None]


_USED = "not empty, and no interrupted render of the same options; name another directory"


@dataclass(frozen=True, kw_only=True, slots=True)
class RenderOptions:
    """How to render a subject."""

    frames: int = 64
    """Frames in all."""
    cameras: int = 8
    """Cameras; the first five are the evaluation views."""
    width: int = 512
    """Image columns, pixels."""
    height: int = 384
    """Image rows, pixels."""
    texture_size: int = 256
    """Side of the average textures, texels."""
    seed: int = 0
    """Fixes the performance."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("frames", 4, 100_000),
            ("cameras", 1, 100),
            ("width", 16, 8192),
            ("height", 16, 8192),
            ("texture_size", 16, 4096),
            ("seed", 0, 2**31),
        ):
            _check_range(self, name, low, high)


@dataclass(frozen=True, kw_only=True, slots=True)
class StageOptions(RenderOptions):
    """Which built-in head to render, and how."""

    head: str = "S1"
    """Identity."""
    bake_size: int = BAKE_SIZE
    """Side of the baked appearance, texels."""
    self_shadow: bool = True
    """False leaves out shadow of the face on itself, which takes seconds to measure."""

    def __post_init__(self) -> None:
        RenderOptions.__post_init__(self)
        _check_range(self, "bake_size", 64, 8192)


def _check_range(options: RenderOptions, name: str, low: int, high: int) -> None:
    value = getattr(options, name)
    if not low <= value <= high:
        raise CaptureError(f"{name} is {value}; allowed are {low} to {high}")


def _png(array: npt.NDArray[Any]) -> bytes:
    out = io.BytesIO()
    Image.fromarray(array).save(out, "PNG", compress_level=1)
    return out.getvalue()


def _fingerprint(options: RenderOptions, subject: Subject) -> str:
    values = {field.name: getattr(options, field.name) for field in fields(options)}
    return json.dumps({"options": values, "subject": subject.describe()}, sort_keys=True)


def render_capture(
    options: StageOptions, out: Path, progress: Progress | None = None
) -> dict[str, Any]:
    """Render a built-in head; arguments, result and errors as `render_subject`."""

    def make() -> Subject:
        return HeadSubject(
            options.head, bake_size=options.bake_size, self_shadow=options.self_shadow
        )

    return render_subject(make, options, out, progress)


def render_subject(
    make_subject: Callable[[], Subject],
    options: RenderOptions,
    out: Path,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Render a capture.

    Args:
        make_subject: Makes who is to be rendered; what that raises is raised before a file is
            written. It is released at the end.
        options: How to render.
        out: Directory to fill: new, empty, or an interrupted render of the same subject and
            options.
        progress: Called with frames done and frames in all.

    Returns:
        Counts: frames, cameras, images, train, test, resumed.

    Raises:
        CaptureError: `out` holds something else, or cannot be written.
        GraphicsError: No GL context.
    """
    if out.exists() and not out.is_dir():
        raise CaptureError(f"{out}: is no directory; name one to make")
    marker = out / "render.json"
    used = out.exists() and any(out.iterdir())
    if used and not marker.is_file():
        raise CaptureError(f"{out}: {_USED}")
    subject = make_subject()
    try:
        fingerprint = _fingerprint(options, subject)
        if used and multiface.read_text(marker) != fingerprint:
            raise CaptureError(f"{out}: {_USED}")
        multiface.write_aside(marker, fingerprint.encode())
        counts = _render(subject, options, out, progress)
    finally:
        subject.release()
    marker.unlink(missing_ok=True)
    return counts


def _render(
    subject: Subject, options: RenderOptions, out: Path, progress: Progress | None
) -> dict[str, Any]:
    cameras = dome_cameras(options.cameras, options.width, options.height)
    takes = sample_takes(options.frames, options.seed)
    multiface.write_aside(out / multiface.KRT, multiface.krt_text(cameras).encode())
    _write_topology(subject.topology, out)
    resumed = done = 0
    identity_transform = "1 0 0 0\n0 1 0 0\n0 0 1 0\n"
    sums = _Sums()
    for take in takes:
        for index, arkit in enumerate(take.arkit):
            frame = f"{index:06d}"
            mesh = out / multiface.mesh_path(take.segment, frame)
            texture_file = out / multiface.texture_path(options.texture_size, take.segment, frame)
            if mesh.is_file() and texture_file.is_file():
                resumed += 1
                with Image.open(texture_file) as image:
                    texture = np.asarray(image)
                vertices_mm = np.frombuffer(mesh.read_bytes(), "<f4").reshape(-1, 3)
            else:
                vertices_mm = (subject.pose(arkit) * multiface.MILLIMETRES).astype("<f4")
                views = []
                for camera in cameras:
                    view = subject.draw(camera)
                    views.append((camera, view))
                    units = np.rint(view.depth_m / multiface.DEPTH_UNIT_M).astype(np.uint16)
                    for kind, pixels in (
                        ("images", view.image),
                        ("depth", units),
                        (multiface.TRUTH_DEPTH, units),
                        ("mask", view.mask),
                    ):
                        path = multiface.image_path(kind, take.segment, camera.name, frame)
                        multiface.write_aside(out / path, _png(pixels))
                unwrapped, _ = subject.unwrap(views, options.texture_size)
                texture = np.ascontiguousarray(unwrapped[::-1])
                multiface.write_aside(texture_file, _png(texture))
                transform = out / multiface.transform_path(take.segment, frame)
                multiface.write_aside(transform, identity_transform.encode())
                truth = out / multiface.mesh_path(take.segment, frame, multiface.TRUTH_MESH)
                multiface.write_aside(truth, vertices_mm.tobytes())
                multiface.write_aside(mesh, vertices_mm.tobytes())
            if take.split == "train":
                sums.add(vertices_mm, texture)
            done += 1
            if progress is not None:
                progress(done, options.frames)
    sums.write(out)
    _write_tables(options, subject, takes, out)
    num_test = sum(len(take.arkit) for take in takes if take.split == "test")
    return {
        "frames": done,
        "cameras": len(cameras),
        "images": done * len(cameras),
        "train": done - num_test,
        "test": num_test,
        "resumed": resumed,
    }


class _Sums:
    """Running mean and variance of training meshes and textures."""

    def __init__(self) -> None:
        self.count = 0
        self.vertices: Any = 0.0
        self.vertices_square: Any = 0.0
        self.texture: Any = 0.0
        self.texture_square: Any = 0.0

    def add(self, vertices_mm: npt.NDArray[np.float32], texture: ByteArray) -> None:
        v, t = vertices_mm.astype(np.float64), texture.astype(np.float64)
        self.count += 1
        self.vertices, self.vertices_square = self.vertices + v, self.vertices_square + v * v
        self.texture, self.texture_square = self.texture + t, self.texture_square + t * t

    def write(self, out: Path) -> None:
        v, t = self.vertices / self.count, self.texture / self.count
        multiface.write_aside(out / "vert_mean.bin", v.astype("<f4").tobytes())
        multiface.write_aside(out / "tex_mean.png", _png(np.rint(t).astype(np.uint8)))
        for name, square, mean in (
            ("vert_var.txt", self.vertices_square, v),
            ("tex_var.txt", self.texture_square, t),
        ):
            variance = float(np.mean(np.maximum(square / self.count - mean * mean, 0.0)))
            multiface.write_aside(out / name, f"{variance:.9g}\n".encode())


def _write_topology(topology: Topology, out: Path) -> None:
    arrays: dict[str, Any] = {"vertex_uv": topology.vertex_uv, "faces": topology.faces}
    arrays |= {f"region_{name}": mask for name, mask in topology.regions.items()}
    data = io.BytesIO()
    np.savez(data, **arrays)  # fixed zip time stamps: the same bytes every time
    multiface.write_aside(out / multiface.TOPOLOGY, data.getvalue())


def _write_tables(options: RenderOptions, subject: Subject, takes: list[Take], out: Path) -> None:
    lines = [",".join(("segment", "frame", "split", *ARKIT_NAMES))]
    names = []
    for take in takes:
        for index, arkit in enumerate(take.arkit):
            numbers = ",".join(f"{value:.6g}" for value in arkit)
            lines.append(f"{take.segment},{index:06d},{take.split},{numbers}")
            names.append(f"{take.segment} {index:06d}")
    multiface.write_aside(out / multiface.EXPRESSIONS, ("\n".join(lines) + "\n").encode())
    multiface.write_aside(out / multiface.FRAME_LIST, ("\n".join(names) + "\n").encode())
    info = {
        "schema": multiface.SCHEMA,
        **subject.describe(),
        "seed": options.seed,
        "units": {"tracked_mesh": "mm", "KRT": "mm", "depth": "0.1 mm", "images": "sRGB 8 bit"},
        "tracked_mesh": "exact synthetic mesh: the rendered surface, without a tracker's errors",
        "width": options.width,
        "height": options.height,
        "texture_size": options.texture_size,
        "topology": multiface.TOPOLOGY,
        "num_vertices": len(subject.topology.vertex_uv),
        "split": {
            split: [take.segment for take in takes if take.split == split]
            for split in ("train", "test")
        },
        "evaluation_views": [name for name in EVALUATION_VIEWS],
    }
    multiface.write_aside(out / multiface.CAPTURE, json.dumps(info, indent=1).encode() + b"\n")
