"""Poses beside the frames: a subject at many more expressions than a capture has frames.

The live encoder learns from them: its geometry from their meshes, its colours from one picture of
each. A frame is drawn by every camera and takes ten times as long. A capture may be without them:
real people cannot be posed.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image as Pillow

from pica_core.capture.dataset.files import IMAGE_FORMATS
from pica_core.capture.stage.expressions import sample_takes
from pica_core.errors import CaptureError
from pica_core.files import replacing
from pica_core.types import FloatArray, Image

FILE = "poses.npz"
PICTURES = "poses"
"""Folder of their pictures."""
POSES_PER_FRAME = 2
"""Poses of a capture for each of its frames (measured: `docs/results/linear`)."""
SEED_STEP = 101
"""Added to a capture's seed for its poses, so that they are of other takes."""


class Poses(NamedTuple):
    """Expressions and what they look like.

    Attributes:
        arkit: float32 ``[P, 52]``.
        vertices_m: Their meshes, head frame, metres, float32 ``[P, V, 3]``.
        cameras: Name of the camera of each pose's picture; empty where there are no pictures.
    """

    arkit: FloatArray
    vertices_m: FloatArray
    cameras: tuple[str, ...] = ()


def pose_expressions(count: int, seed: int) -> FloatArray:
    """Expressions, at least 4, of takes that a capture of this seed has not. ``[P, 52]``."""
    return np.concatenate([take.arkit for take in sample_takes(count, seed + SEED_STEP)])


def picture_path(folder: Path, number: int) -> Path:
    """Where a capture keeps the picture of a pose."""
    return folder / PICTURES / f"{number:06d}.png"


def read_picture(folder: Path, number: int) -> Image:
    """The picture of a pose, uint8 ``[H, W, 3]``.

    Raises:
        CaptureError: It is missing or damaged.
    """
    path = picture_path(folder, number)
    try:
        with Pillow.open(path, formats=IMAGE_FORMATS) as picture:
            return np.asarray(picture.convert("RGB"))
    except (OSError, SyntaxError, ValueError) as error:
        raise CaptureError(f"{path}: cannot be read ({error}); capture anew") from error


def write_poses(folder: Path, poses: Poses) -> None:
    """Write poses into a capture: offsets from the first mesh, which is at rest, in fp16 (0.01 mm).

    Raises:
        CaptureError: The file cannot be written.
    """
    first = poses.vertices_m[0]
    try:
        with replacing(folder / FILE) as unfinished, unfinished.open("wb") as file:
            offsets_mm = ((poses.vertices_m - first) * 1000).astype(np.float16)
            cameras = np.array(poses.cameras, np.str_)
            kept = {"arkit": poses.arkit, "rest_m": first, "offsets_mm": offsets_mm}
            np.savez(file, cameras=cameras, **kept)
    except OSError as error:
        raise CaptureError(f"{folder / FILE}: cannot be written: {error.strerror}") from error


def read_poses(folder: Path, num_vertices: int) -> Poses | None:
    """Poses of a capture; None if it has none.

    Raises:
        CaptureError: The file is damaged, or of another mesh.
    """
    path = folder / FILE
    if not path.is_file():
        return None
    try:
        with np.load(path) as found:
            arkit, rest_m = found["arkit"], found["rest_m"]
            cameras = tuple(found["cameras"].tolist()) if "cameras" in found else ()
            vertices_m = rest_m + found["offsets_mm"].astype(np.float32) / np.float32(1000)
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise CaptureError(f"{path}: is damaged ({error}); remove it, or capture anew") from error
    if vertices_m.shape != (len(arkit), num_vertices, 3):
        raise CaptureError(f"{path}: meshes are {vertices_m.shape[1:]}; {num_vertices} are needed")
    if cameras and len(cameras) != len(arkit):
        raise CaptureError(f"{path}: {len(cameras)} pictures of {len(arkit)} poses; capture anew")
    return Poses(arkit, vertices_m, cameras)
