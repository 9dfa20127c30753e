"""What benches share: turns, times, tables and options; and one head before a camera, at rest or
talking.

Cases of a bench take turns, round after round, so that a busy machine treats all alike; the first
rounds warm up and are not counted. Results are medians.
"""

import math
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from statistics import median, quantiles
from typing import Annotated, Any, TypeVar

import moderngl
import numpy as np
import numpy.typing as npt
from cyclopts import Parameter, Token

from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.request import DecodedMaps
from pica_client.errors import OptionError
from pica_client.render.drawing import Drawing, HeadRenderer
from pica_client.render.scene import head_matrix, view_direction
from pica_client.stats import describe_machine, percentile
from pica_client.system import Closing, say
from pica_core.avatar.file import Avatar
from pica_core.avatar.manifest import Manifest
from pica_core.camera import Camera, dome_cameras, look_at
from pica_core.gl import create_context
from pica_core.types import FloatArray

T = TypeVar("T")
Case = TypeVar("Case")

NUM_REPORTS = 5
"""Reports of progress on stderr of one bench."""


def timed(work: Callable[..., T], *arguments: Any) -> tuple[float, T]:
    """Do some work; the seconds that it took, and its result."""
    begin_s = time.perf_counter()
    result = work(*arguments)
    return time.perf_counter() - begin_s, result


def take_turns(
    cases: Sequence[Case], work: Callable[[Case, int], T], *, rounds: int, warm_up: int
) -> list[list[T]]:
    """Let every case work once a round, every second round backwards, and report progress.

    Args:
        work: Does a case's work of a round, given its number: negative while warming up.
        warm_up: Rounds before them.

    Returns:
        The results of the rounds that count, by case.
    """
    found: list[list[T]] = [[] for _ in cases]
    for number in range(-warm_up, rounds):
        if number >= 0 and number % max(rounds // NUM_REPORTS, 1) == 0:
            say(f"round {number} of {rounds}")
        for index in range(len(cases))[:: -1 if number > 0 and number % 2 else 1]:
            result = work(cases[index], number)
            if number >= 0:
                found[index].append(result)
    return found


def times_ms(samples_s: Sequence[float]) -> dict[str, float]:
    """Median and 95th percentile in milliseconds, and the quartiles' distance over the median."""
    ordered = sorted(samples_s)
    low, middle, high = quantiles(ordered, n=4) if len(ordered) > 1 else ordered * 3
    return {
        "ms": round(median(ordered) * 1e3, 3),
        "p95": round(percentile(ordered, 95) * 1e3, 3),
        "spread": round((high - low) / middle, 3),
    }


def ratio(over_s: Sequence[float], under_s: Sequence[float]) -> float:
    """The median over rounds of two times of the same round."""
    return round(median(a / b for a, b in zip(over_s, under_s, strict=True)), 3)


def report(config: Any, rows: Sequence[Mapping[str, Any]], **more: Any) -> dict[str, Any]:
    """Return the result of a bench: its rows, its options, and what it was measured on.

    Args:
        config: A dataclass of plain values.
    """
    options = {
        name: str(value) if isinstance(value, Path) else value
        for name, value in asdict(config).items()
    }
    return {"rows": list(rows), **more, "options": options, "machine": describe_machine()}


def say_rows(rows: Sequence[Mapping[str, Any]], columns: str) -> None:
    """Print some fields of the rows of a result as a table.

    Args:
        columns: Names of fields, with spaces between.
    """
    names = columns.split()
    lines = [names, *([_shown(row[name]) for name in names] for row in rows)]
    widths = [max(map(len, cells)) for cells in zip(*lines, strict=True)]
    for line in lines:
        say("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))


def _shown(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _words(_type: object, tokens: Sequence[Token]) -> tuple[str, ...]:
    return tuple(part.strip() for part in tokens[0].value.split(",") if part.strip())


Words = Annotated[
    tuple[str, ...], Parameter(converter=_words, n_tokens=1, metavar="NAMES", show_default=",".join)
]
"""A list as one word of the command line."""


def check_names(option: str, names: Iterable[str], known: Collection[str]) -> None:
    """Refuse names that an option does not have.

    Raises:
        OptionError: Names it, and those that are known.
    """
    for name in names:
        if name not in known:
            raise OptionError(f"{option} {name!r} is unknown; known are {', '.join(known)}")


FIELD_OF_VIEW = math.radians(50)
"""Opening of the camera both ways, radians: the distances 18, 65 and 120 cm then cover pixels in
about the ratios of the paper's Table 3 (2.7 : 0.9 : 0.2 million)."""
_NO_POSE = np.zeros(3, np.float32)


def front_camera(head: Manifest, distance_cm: float, size: tuple[int, int]) -> Camera:
    """A camera before the middle of a head.

    Args:
        distance_cm: From the front of its bounding box.
        size: Columns and rows of the image, pixels.
    """
    low, high = head.bounds_min_m, head.bounds_max_m
    height, distance_m = (low[1] + high[1]) / 2, high[2] + distance_cm / 100
    return look_at(
        centre_m=(0.0, height, distance_m),
        target_m=(0.0, height, 0.0),
        vertical_fov=FIELD_OF_VIEW,
        width=size[0],
        height=size[1],
    )


@contextmanager
def gl_context() -> Iterator[moderngl.Context]:
    """A GL context for a block.

    Raises:
        GraphicsError: There is none; names the fix.
    """
    context = create_context()
    try:
        yield context
    finally:
        context.release()


class FaceRenderer(Closing):
    """Draws the latents of one avatar from views of the stage, through the real decoder and
    renderer; belongs to one thread.

    Args:
        size_px: Rows and columns of each image.
        views: Names among the stage's evaluation views.

    Raises:
        GraphicsError: No GL context; names the fix.
    """

    def __init__(self, avatar: Avatar, *, size_px: int, views: Sequence[str]) -> None:
        self._cameras = evaluation_cameras(views, size_px)
        self._decoder = OnnxDecoder(avatar)
        self._context = create_context()
        self._renderer = HeadRenderer(self._context, avatar, size_px)

    def draw(
        self,
        latent: FloatArray,
        rotation: npt.ArrayLike = _NO_POSE,
        translation_m: npt.ArrayLike = _NO_POSE,
        level: int | None = None,
    ) -> list[tuple[Drawing, DecodedMaps]]:
        """Draw a face from every view; what was drawn, and what it was drawn of.

        Args:
            latent: float32 ``[8, 8, 4]``.
            rotation: Head pose, rotation vector in radians ``[3]``.
            translation_m: Head offset, metres ``[3]``.
            level: Of detail; None is the full one.
        """
        matrix = head_matrix(np.eye(4), rotation, translation_m)
        drawn = []
        for camera in self._cameras:
            maps = self._decoder.decode(latent, view_direction(matrix, camera.centre_m), level)
            drawn.append((self._renderer.draw(maps, camera, matrix), maps))
        return drawn

    def close(self) -> None:
        """Give the GL context back."""
        self._context.release()


def evaluation_cameras(views: Sequence[str], size_px: int) -> tuple[Camera, ...]:
    """The stage's cameras of some evaluation views."""
    by_name = {camera.name: camera for camera in dome_cameras(5, size_px, size_px)}
    return tuple(by_name[name] for name in views)
