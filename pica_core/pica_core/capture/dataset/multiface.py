"""The files of a capture in the Multiface layout, and our additions: names and small text formats.

What is missing, damaged or cannot be written is a `CaptureError` that names the file.

    KRT                                   cameras: name / 3 lines K / 1 line distortion / 3 lines
    [R|t] in mm / blank
    frame_list.txt                        "SEGMENT FRAME" per line
    images/SEG/CAM/FRAME.png              sRGB 8 bit
    tracked_mesh/SEG/FRAME.bin            float32 [V, 3], head frame, mm
    tracked_mesh/SEG/FRAME_transform.txt  3x4 head-to-world, mm
    unwrapped_uv_SIZE/SEG/average/FRAME.png   upside down, as in the original
  additions
    depth/SEG/CAM/FRAME.png               16 bit, 0.1 mm along the camera axis, 0 = empty
    expressions.csv                       segment, frame, split, 52 ARKit values
    capture.json                          units, source, licence, split, sizes, topology
    topology.npz                          vertex_uv, faces, region masks of the mesh that is drawn
    tracked_topology.npz                  the same of the tracked mesh, where that is another one
    truth_mesh/SEG/FRAME.bin              exact mesh, float32 [V, 3], head frame, mm (no real ones)
    poses.npz                             meshes alone, of other expressions (no real ones)

Layout source: the published description of the Multiface dataset (Wuu et al. 2022, arXiv
2207.11243).
"""

import json
import logging
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from pica_core.camera import Camera
from pica_core.errors import CaptureError
from pica_core.files import replacing

log = logging.getLogger(__name__)

KRT = "KRT"
FRAME_LIST = "frame_list.txt"
EXPRESSIONS = "expressions.csv"
CAPTURE = "capture.json"
TOPOLOGY = "topology.npz"
TRACKED_TOPOLOGY = "tracked_topology.npz"
MARKER = "render.json"
"""There while a capture is being rendered."""
MATERIALS = ("skin", "eye", "teeth", "tongue", "mouth_bag", "collar", "hair")
"""Material ids, in the order that the appearance shaders know."""
TRUTH_MESH = "truth_mesh"
SCHEMA = 1
MAX_KRT = 1e6
"""No number of a KRT file is larger: pixels, or mm."""
DEPTH_UNIT_M = 0.0001
MILLIMETRES = 1000.0


def image_path(kind: str, segment: str, camera: str, frame: str) -> Path:
    """Relative path of an ``images`` or ``depth`` file."""
    return Path(kind) / segment / camera / f"{frame}.png"


def mesh_path(segment: str, frame: str, kind: str = "tracked_mesh") -> Path:
    """Relative path of a ``tracked_mesh`` or ``truth_mesh`` file."""
    return Path(kind) / segment / f"{frame}.bin"


def transform_path(segment: str, frame: str) -> Path:
    """Relative path of a frame's head-to-world transform."""
    return Path("tracked_mesh") / segment / f"{frame}_transform.txt"


def texture_path(size: int, segment: str, frame: str) -> Path:
    """Relative path of an average texture."""
    return Path(f"unwrapped_uv_{size}") / segment / "average" / f"{frame}.png"


def write_aside(path: Path, data: bytes) -> None:
    """Write a file, whole or not at all, and the folder that it is in."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as unfinished:
            unfinished.write_bytes(data)
    except OSError as error:
        raise CaptureError(f"{path}: cannot write ({error.strerror or error})") from error


def krt_text(cameras: Iterable[Camera]) -> str:
    """Cameras as a KRT file; translations in mm."""
    lines: list[str] = []
    for camera in cameras:
        lines.append(camera.name)
        lines += [" ".join(repr(float(v)) for v in row) for row in camera.intrinsics]
        lines.append("0 0 0 0 0")
        rt = np.concatenate([camera.rotation, MILLIMETRES * camera.translation_m[:, None]], 1)
        lines += [" ".join(repr(float(v)) for v in row) for row in rt]
        lines.append("")
    return "\n".join(lines) + "\n"


def read_krt(path: Path, width: int, height: int) -> tuple[Camera, ...]:
    """Cameras of a KRT file, which does not hold the size of images."""
    lines = [line.strip() for line in read_text(path).split("\n")]
    cameras: list[Camera] = []
    at = 0
    while at < len(lines):
        if not lines[at]:
            at += 1
            continue
        name = lines[at]
        rows: list[list[float]] = []
        for offset, wanted in enumerate((3, 3, 3, 5, 4, 4, 4), start=1):
            text = lines[at + offset] if at + offset < len(lines) else ""
            try:
                values = [float(word) for word in text.split()]
            except ValueError:
                values = []
            fine = np.isfinite(values).all() and np.abs(values or [0.0]).max() <= MAX_KRT
            if len(values) != wanted or not fine:
                raise CaptureError(
                    f"{path}:{at + offset + 1}: camera {name}: {wanted} numbers are needed, "
                    f"found {text!r}"
                )
            rows.append(values)
        if np.abs(rows[3]).max() > 1e-6:
            log.warning(
                "%s: camera %s states lens distortion; its images are taken as undistorted",
                path, name,
            )  # fmt: skip
        matrix = np.array(rows[4:7])
        cameras.append(
            Camera(
                name=name,
                intrinsics=np.array(rows[:3]),
                rotation=matrix[:, :3].copy(),
                translation_m=matrix[:, 3] / MILLIMETRES,
                width=width,
                height=height,
            )
        )
        at += 8
    if not cameras:
        raise CaptureError(f"{path}: no camera in the file")
    names = [camera.name for camera in cameras]
    if len(set(names)) < len(names):
        twice = next(name for index, name in enumerate(names) if name in names[:index])
        raise CaptureError(f"{path}: camera {twice} is there twice")
    return tuple(cameras)


def read_text(path: Path) -> str:
    """Read a text file of a capture."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise CaptureError(f"{path}: the file is missing") from None
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{path}: cannot read ({error})") from error


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON map."""
    try:
        value = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise CaptureError(f"{path}: not JSON ({error})") from error
    if not isinstance(value, dict):
        raise CaptureError(f"{path}: a JSON map is needed")
    return value
