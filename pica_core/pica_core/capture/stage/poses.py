"""Poses without pictures: meshes of a subject at many more expressions than a capture has frames.

A picture takes ten times as long as a mesh, and the live encoder's geometry needs meshes alone. A
capture holds them in one file, which may be absent: real people cannot be posed.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pica_core.capture.stage.expressions import sample_takes
from pica_core.errors import CaptureError
from pica_core.files import replacing
from pica_core.types import FloatArray

FILE = "poses.npz"
POSES_PER_FRAME = 2
"""Poses of a capture for each of its frames (measured: `docs/results/linear`)."""
SEED_STEP = 101
"""Added to a capture's seed for its poses, so that they are of other takes."""


class Poses(NamedTuple):
    """Expressions ``[P, 52]`` and their meshes, head frame, metres ``[P, V, 3]``; float32 both."""

    arkit: FloatArray
    vertices_m: FloatArray


def pose(vertices: Callable[[FloatArray], FloatArray], count: int, seed: int) -> Poses:
    """Pose a subject at `count` expressions of takes that a capture of this seed has not.

    Args:
        vertices: Expression ``[52]`` to mesh ``[V, 3]``.
        count: How many, at least 4.
        seed: The capture's.
    """
    arkit = np.concatenate([take.arkit for take in sample_takes(count, seed + SEED_STEP)])
    return Poses(arkit, np.stack([vertices(values) for values in arkit]).astype(np.float32))


def write_poses(folder: Path, poses: Poses) -> None:
    """Write poses into a capture: offsets from the first mesh, which is at rest, in fp16 (0.01 mm).

    Raises:
        CaptureError: The file cannot be written.
    """
    first = poses.vertices_m[0]
    try:
        with replacing(folder / FILE) as unfinished, unfinished.open("wb") as file:
            offsets_mm = ((poses.vertices_m - first) * 1000).astype(np.float16)
            np.savez(file, arkit=poses.arkit, rest_m=first, offsets_mm=offsets_mm)
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
            vertices_m = rest_m + found["offsets_mm"].astype(np.float32) / np.float32(1000)
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise CaptureError(f"{path}: is damaged ({error}); remove it, or capture anew") from error
    if vertices_m.shape != (len(arkit), num_vertices, 3):
        raise CaptureError(f"{path}: meshes are {vertices_m.shape[1:]}; {num_vertices} are needed")
    return Poses(arkit, vertices_m)
