"""Error against milliseconds for every way to show a face: level, mesh, precision of the weights,
block of the decoders.

The fields of its rows stand in ``docs/benches.md``. What it does not show: the trained errors of
other blocks and of the paper's ablations, which need those models; several heads (`pica bench
scene`).
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import moderngl
import numpy as np

from pica_client.avatars.level_errors import averaged
from pica_client.bench.decode import random_decoders
from pica_client.bench.harness import gl_context, median_ms, take_turns, timed
from pica_client.bench.head import check_distances, front_camera, talk_frames
from pica_client.bench.option_types import Floats
from pica_client.decode.decoder import OnnxDecoder
from pica_client.errors import check_ranges
from pica_client.render.drawing import Drawing, HeadRenderer, change_mse, drawn_mse
from pica_client.render.scene import view_direction
from pica_client.stats import describe_machine
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar, load_avatar, save_avatar
from pica_core.avatar.spec import BLOCKS
from pica_core.avatar.storage import DEFAULT_STORAGE, Storage
from pica_core.camera import Camera
from pica_core.gl import wait_for_gpu

SAMPLES = 3
"""Samples of the truth along each side of a pixel."""
WARM_UP_FRAMES = 2
SAME_COST = 0.05
"""Costs closer than this share are taken to be the same."""
PRECISIONS: tuple[Storage, ...] = ("f32", "f16", "u8")


@dataclass(frozen=True, kw_only=True, slots=True)
class ParetoBenchConfig:
    """What to measure."""

    distances_cm: Floats = (18.0, 65.0, 120.0)
    """Distances of the camera from the front of the head, separated by commas."""
    image_size: int = 768
    """Rows and columns of the image, pixels."""
    frames: int = 16
    """Frames of each candidate, 30 a second."""
    performance: str = "talk"
    """What the head does: talk, listen or range-of-motion."""
    start_s: float = 3.0
    """Second of it at which the frames begin."""

    def __post_init__(self) -> None:
        check_distances(self.distances_cm)
        check_ranges(self, image_size=(64, 2048), frames=(3, 1000))


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """One way to show the face."""

    model: str
    level: int
    mesh: int
    precision: str
    distance_cm: float
    decoder: OnnxDecoder
    is_drawn: bool
    """False for random weights: they make no face, and what one costs to draw is known."""
    file_bytes: int | None


class _Frame(NamedTuple):
    """What a frame of a candidate took and left; cost and error of drawing are None undrawn."""

    decode_s: float
    draw_s: float = 0.0
    mse: float | None = None
    change_mse: float | None = None


def run_pareto_bench(config: ParetoBenchConfig, avatar: Avatar) -> dict[str, Any]:
    """Measure all candidates.

    Raises:
        GraphicsError: No GL context.
    """
    with gl_context() as context:
        bench = _Bench(context, config, avatar)
        return {
            "avatar": avatar.manifest.identity,
            "gl_renderer": bench.gl_renderer,
            "image_size": config.image_size,
            "frames": config.frames,
            "performance": config.performance,
            "rows": mark_best(bench.run()),
            "machine": describe_machine(),
        }


class _Bench:
    def __init__(
        self, context: moderngl.Context, config: ParetoBenchConfig, avatar: Avatar
    ) -> None:
        self._context, self._config, self._avatar = context, config, avatar
        self._renderer = HeadRenderer(context, avatar, config.image_size)
        self._fine = HeadRenderer(context, avatar, config.image_size * SAMPLES)
        self._truth_decoder = OnnxDecoder(avatar)
        self.gl_renderer = self._renderer.gl_renderer
        encoder = ExpressionEncoder(avatar)
        talk = talk_frames(config.performance, config.start_s, WARM_UP_FRAMES, config.frames)
        self._frames = [(encoder.encode(arkit), matrix) for arkit, matrix in talk]
        # A frame and the one before it, at every distance.
        self._truth = lru_cache(2 * len(config.distances_cm))(self._draw_truth)
        self._before: dict[_Candidate, Drawing] = {}

    def run(self) -> list[dict[str, Any]]:
        """Show all frames in all ways; a row for each way."""
        candidates, rounds = self._candidates(), self._config.frames
        frames = take_turns(candidates, self._show, rounds=rounds, warm_up=WARM_UP_FRAMES)
        return [_row(*each) for each in zip(candidates, frames, strict=True)]

    def _candidates(self) -> list[_Candidate]:
        avatar, full = self._avatar, self._avatar.levels[-1]
        found: list[tuple[str, str, OnnxDecoder, bool, int | None, Sequence[int]]] = []
        for precision in PRECISIONS:
            stored, file_bytes = with_precision(avatar, precision)
            levels = avatar.levels
            found.append(("pica", precision, OnnxDecoder(stored), True, file_bytes, levels))
        for block in BLOCKS:
            if block == avatar.spec.block:
                continue
            other = random_decoders(avatar, block, seed=0)
            found.append((f"block {block}", "f32", OnnxDecoder(other), False, None, (full,)))
        return [
            _Candidate(model, level, mesh, precision, distance, decoder, is_drawn, file_bytes)
            for distance in self._config.distances_cm
            for model, precision, decoder, is_drawn, file_bytes, levels in found
            for level in levels
            for mesh in avatar.levels
            # Fewer triangles cost and lose the same whatever the weights were stored as.
            if mesh == level or (model, precision, level) == ("pica", "f32", full)
        ]

    def _show(self, candidate: _Candidate, number: int) -> _Frame:
        """Decode and draw one frame, and compare it with the truth."""
        latent, matrix = self._frames[number + WARM_UP_FRAMES]
        camera = self._camera(candidate.distance_cm, self._config.image_size)
        direction = view_direction(matrix, camera.centre_m)
        decoded, maps = timed(candidate.decoder.decode, latent, direction, candidate.level)
        if not candidate.is_drawn:
            return _Frame(decoded.wall_s)
        self._renderer.upload(maps)

        def draw() -> None:
            self._renderer.submit(camera, matrix, candidate.mesh)
            wait_for_gpu(self._context)

        drawn, _ = timed(draw)
        drawing, truth = self._renderer.read(), self._truth(number, candidate.distance_cm)
        change = None
        if (before := self._before.get(candidate)) is not None:
            true_before = self._truth(number - 1, candidate.distance_cm)
            change = change_mse((before, drawing), (true_before, truth))
        self._before[candidate] = drawing
        return _Frame(decoded.wall_s, drawn.wall_s, drawn_mse(drawing, truth), change)

    def _draw_truth(self, number: int, distance_cm: float) -> Drawing:
        latent, matrix = self._frames[number + WARM_UP_FRAMES]
        camera = self._camera(distance_cm, self._config.image_size * SAMPLES)
        maps = self._truth_decoder.decode(latent, view_direction(matrix, camera.centre_m))
        fine = self._fine.draw(maps, camera, matrix)
        image = np.rint(averaged(fine.image, SAMPLES)).astype(np.uint8)
        return Drawing(image, averaged(fine.covered[..., None], SAMPLES)[..., 0] >= 0.5)

    def _camera(self, distance_cm: float, pixels: int) -> Camera:
        return front_camera(self._avatar.manifest, distance_cm, (pixels, pixels))


def with_precision(avatar: Avatar, precision: Storage) -> tuple[Avatar, int]:
    """An avatar as it comes back from a file that stores its decoders' weights so, and the size of
    that file, bytes."""
    storage: dict[str, Storage] = dict(DEFAULT_STORAGE)
    for name, array in avatar.tensors.items():
        is_weight = name.startswith(("geometry.", "expression.", "level."))
        if is_weight and array.ndim >= 1 and name.endswith((".weight", ".bias")):
            storage[name] = precision
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "avatar.pica"
        save_avatar(path, avatar, storage)
        return load_avatar(path), path.stat().st_size


def mark_best(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The same rows with ``is_best``: nothing at the same distance is cheaper and better."""

    def beats(other: dict[str, Any], row: dict[str, Any]) -> bool:
        is_cheaper = other["total_ms"] < row["total_ms"] * (1 - SAME_COST)
        is_no_dearer = other["total_ms"] <= row["total_ms"] * (1 + SAME_COST)
        is_better, is_no_worse = other["mse"] < row["mse"], other["mse"] <= row["mse"]
        return bool((is_cheaper and is_no_worse) or (is_no_dearer and is_better))

    compared = [row for row in rows if row["mse"] is not None]
    for row in rows:
        rivals = [each for each in compared if each["distance_cm"] == row["distance_cm"]]
        row["is_best"] = row["mse"] is not None and not any(beats(each, row) for each in rivals)
    return rows


def _row(candidate: _Candidate, frames: Sequence[_Frame]) -> dict[str, Any]:
    decode_s, draw_s, mse, change_mse = zip(*frames, strict=True)
    is_drawn = candidate.is_drawn
    return {
        "model": candidate.model,
        "level": candidate.level,
        "mesh": candidate.mesh,
        "precision": candidate.precision,
        "file_bytes": candidate.file_bytes,
        "distance_cm": candidate.distance_cm,
        "decode_ms": median_ms(decode_s),
        "draw_ms": median_ms(draw_s) if is_drawn else None,
        "total_ms": round((median(decode_s) + median(draw_s)) * 1e3, 3) if is_drawn else None,
        "mse": round(float(np.mean(mse)), 4) if is_drawn else None,
        "change_mse": round(float(np.mean(change_mse)), 4) if is_drawn else None,
    }
