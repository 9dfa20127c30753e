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
    topology.npz                          vertex_uv, faces, region masks of the mesh that is drawn;
                                          where the tracked mesh has some of its vertices alone,
                                          which they are, dense_vertex, and tracked_faces
    truth_mesh/SEG/FRAME.bin              exact mesh, float32 [V, 3], head frame, mm (no real ones)
    poses.npz                             meshes alone, of other expressions (no real ones)

Layout source: the published description of the Multiface dataset (Wuu et al. 2022, arXiv
2207.11243).
"""

import json
import logging
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from pica_core.camera import Camera
from pica_core.capture.dataset.members import Member
from pica_core.errors import CaptureError
from pica_core.files import replacing
from pica_core.types import Float64Array

log = logging.getLogger(__name__)

KRT = "KRT"
FRAME_LIST = "frame_list.txt"
EXPRESSIONS = "expressions.csv"
CAPTURE = "capture.json"
TOPOLOGY = "topology.npz"
MARKER = "render.json"
"""There while a capture is being rendered."""
MATERIALS = ("skin", "eye", "teeth", "tongue", "mouth_bag", "collar", "hair")
"""Material ids, in the order that the appearance shaders know."""
TRUTH_MESH = "truth_mesh"
SCHEMA = 1
MAX_FILE_BYTES = 1 << 30
"""Larger files are refused before reading."""
MAX_KRT = 1e6
"""No number of a KRT file is larger: pixels, or mm."""
STRAIGHT = 1e-6
"""A lens of less distortion has none."""
DEPTH_UNIT_M = 0.0001
MILLIMETRES = 1000.0


def part_path(kind: str, segment: str, frame: str, camera: str = "", *, size: int = 0) -> Path:
    """Relative path of a part of a frame: ``images`` or ``depth`` of a camera, ``tracked_mesh`` or
    ``truth_mesh``, the head's ``pose``, or its average ``texture`` of this size."""
    if camera:
        return Path(kind) / segment / camera / f"{frame}.png"
    if kind == "pose":
        return Path("tracked_mesh") / segment / f"{frame}_transform.txt"
    if kind == "texture":
        return Path(f"unwrapped_uv_{size}") / segment / "average" / f"{frame}.png"
    return Path(kind) / segment / f"{frame}.bin"


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
    cameras: dict[str, Camera] = {}
    distorted: list[str] = []
    for block in re.split(r"\n\s*\n", read_text(path).strip()):
        name, *lines = block.strip().splitlines()
        where = f"{path}: camera {name.strip()}"
        try:
            numbers = np.array([float(word) for line in lines for word in line.split()])
        except ValueError:
            numbers = np.zeros(0)
        if numbers.shape != (26,):
            raise CaptureError(
                f"{where}: 9 numbers of K, 5 of distortion and 12 of [R|t] are needed"
            )
        if name.strip() in cameras:
            raise CaptureError(f"{where} is there twice")
        distorted += [name.strip()] * bool(np.abs(numbers[9:14]).max() > STRAIGHT)
        cameras[name.strip()] = make_camera(
            where,
            name.strip(),
            numbers[:9].reshape(3, 3),
            numbers[14:].reshape(3, 4),
            width,
            height,
        )
    tell_distorted(path, distorted)
    return tuple(cameras.values())


def make_camera(
    where: str, name: str, intrinsics: Float64Array, matrix: Float64Array, width: int, height: int
) -> Camera:
    """A camera of K ``[3, 3]`` and world-to-camera ``[R|t]`` in mm ``[3, 4]``.

    Raises:
        CaptureError: They are no camera's; begins with `where`.
    """
    if not max(np.abs(intrinsics).max(), np.abs(matrix).max()) <= MAX_KRT:
        raise CaptureError(f"{where}: a number is not finite, or beyond {MAX_KRT:g}")
    if min(intrinsics[0, 0], intrinsics[1, 1]) <= 0 or not is_rotation(matrix[:, :3]):
        raise CaptureError(f"{where}: a focal length is not above 0, or R is no rotation")
    return Camera(
        name=name,
        intrinsics=intrinsics,
        rotation=matrix[:, :3].copy(),
        translation_m=matrix[:, 3] / MILLIMETRES,
        width=width,
        height=height,
    )


def tell_distorted(path: Path, names: list[str]) -> None:
    """Tell once which cameras have a lens distortion, which is not corrected."""
    if names:
        log.warning(
            "%s: camera %s states lens distortion, as do %d more; images are taken as undistorted",
            path, names[0], len(names) - 1,
        )  # fmt: skip


def is_rotation(matrix: Float64Array) -> bool:
    """Return True if a matrix ``[3, 3]`` is a rotation, about."""
    off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    return off < 1e-3 and float(np.linalg.det(matrix)) > 0


def read_bytes(path: Path | Member) -> bytes:
    """Read a whole file of at most `MAX_FILE_BYTES`."""
    try:
        if isinstance(path, Path) and (size := path.stat().st_size) > MAX_FILE_BYTES:
            raise CaptureError(f"{path}: {size} bytes; at most {MAX_FILE_BYTES} are allowed")
        return path.read_bytes()
    except FileNotFoundError:
        raise CaptureError(f"{path}: the file is missing") from None
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read ({error.strerror})") from error


def read_text(path: Path | Member) -> str:
    """Read a text file of a capture."""
    try:
        return read_bytes(path).decode()
    except UnicodeDecodeError as error:
        raise CaptureError(f"{path}: not a text file ({error})") from error


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON map."""
    try:
        value = json.loads(read_text(path).removeprefix("\ufeff"))
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{path}: not JSON ({error})") from error
    if not isinstance(value, dict):
        raise CaptureError(f"{path}: a JSON map is needed")
    return value
