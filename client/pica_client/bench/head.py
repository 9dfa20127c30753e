"""What several benches draw and how they time it: one head before a camera, at rest or talking."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from pica_client.errors import OptionError
from pica_client.render.gpu_textured import TexturedMesh
from pica_client.render.scene import head_matrix
from pica_client.sources.performances import make_performance
from pica_core.avatar.baseline import BaselineAvatar
from pica_core.camera import Camera, look_at
from pica_core.types import FloatArray

T = TypeVar("T")

FIELD_OF_VIEW = math.radians(50)
"""Of the square image, both ways (chosen: `bench_render` says why)."""
FRAME_S = 1 / 30
"""From one frame of a talking head to the next."""


class Bounded(Protocol):
    """Somebody's head: the manifest of an avatar, or a baseline."""

    @property
    def bounds_min_m(self) -> tuple[float, float, float]:
        """Lower corner of all its positions, head frame, metres."""
        ...

    @property
    def bounds_max_m(self) -> tuple[float, float, float]:
        """Upper corner."""
        ...


class Took(NamedTuple):
    """What some work took.

    Attributes:
        wall_s: By the clock.
        cpu_s: Of all threads of this process.
    """

    wall_s: float
    cpu_s: float


class TalkFrame(NamedTuple):
    """A moment of a performance.

    Attributes:
        arkit: The face, float32 ``[52]``.
        matrix: World from head, float32 ``[4, 4]``.
    """

    arkit: FloatArray
    matrix: FloatArray


def front_camera(
    head: Bounded, distance_cm: float, size: tuple[int, int], *, away: bool = False
) -> Camera:
    """A camera before the middle of a head.

    Args:
        head: Whose.
        distance_cm: From the front of its bounding box.
        size: Columns and rows of the image, pixels.
        away: Look the other way.
    """
    low, high = head.bounds_min_m, head.bounds_max_m
    height, distance_m = (low[1] + high[1]) / 2, high[2] + distance_cm / 100
    return look_at(
        centre_m=(0.0, height, distance_m),
        target_m=(0.0, height, 2 * distance_m if away else 0.0),
        vertical_fov=FIELD_OF_VIEW,
        width=size[0],
        height=size[1],
    )


def talk_frames(performance: str, start_s: float, warm_up: int, frames: int) -> Iterator[TalkFrame]:
    """Frames of a shipped performance, 30 a second.

    Args:
        performance: Its name.
        start_s: Where in it the frames after the warm-up begin, seconds.
        warm_up: Frames that come before them.
        frames: How many to measure.
    """
    source = make_performance(performance)
    for index in range(-warm_up, frames):
        face = source.frame_at(start_s + index * FRAME_S)
        matrix = head_matrix(np.eye(4), face.rotation, face.translation_m)
        yield TalkFrame(face.arkit, matrix)


def textured_mesh(baseline: BaselineAvatar) -> TexturedMesh:
    """What of a baseline never changes, as a renderer takes it."""
    return TexturedMesh(
        vertex_uv=baseline.vertex_uv,
        faces=baseline.faces,
        low_m=baseline.bounds_min_m,
        high_m=baseline.bounds_max_m,
        texture_size=baseline.spec.texture_size,
    )


def timed(work: Callable[[], T]) -> tuple[Took, T]:
    """Do some work; what it took, and what came of it."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    result = work()
    return Took(time.perf_counter() - wall_s, time.process_time() - cpu_s), result


def check_distances(distances_cm: tuple[float, ...]) -> None:
    """Refuse distances to which no camera can be put.

    Raises:
        OptionError: None at all, or one that is not 1 to 1000 cm.
    """
    if not distances_cm or not all(1 <= d <= 1000 for d in distances_cm):
        raise OptionError(f"distances_cm are {distances_cm}; 1 to 1000 are allowed")
