"""Error against milliseconds for every way to show a face: level, mesh, precision of the weights,
block of the decoders.

A talking head at several distances, laid out as in `bench_render`. The truth of a frame is the full
level of the avatar as it is in memory, drawn with `SAMPLES` x `SAMPLES` samples a pixel. Every
contender decodes the same latents and draws the same frames; contenders take turns, frame by frame.

Rows:

    model            "pica": the avatar; "block B" and so on: the paper's sizes with another block
                     and random weights: they have a cost and no error
    level            texels per side of the maps
    mesh             level of the triangles; other than `level` with the full maps alone
    precision        of the decoders' weights: "f32" as in memory, "f16", "u8" as a file may hold
                     them; they are widened when the file is read, so they cost the same time
    file_bytes       of an avatar file that stores them so; null where there is no such file
    distance_cm
    decode_ms draw_ms total_ms     medians over frames
    mse              0-255, over covered pixels, mean over frames
    change_mse       of the change from frame to frame: flicker, which `mse` does not see
    is_best          whether no other contender at this distance is both cheaper and better; cost is
                     compared in steps of `SAME_COST`, which is what a busy machine can tell

What it does not show: the trained errors of other blocks and of the paper's ablations, which need
those models; several heads (`pica bench scene`).
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import moderngl
import numpy as np

from pica_client.bench.decode import random_decoders
from pica_client.bench.head import check_distances, front_camera, talk_frames
from pica_client.bench.render_error import masked_mse
from pica_client.decode.decoder import OnnxDecoder
from pica_client.errors import OptionError
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, view_direction
from pica_client.stats import describe_machine
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar, load_avatar, save_avatar
from pica_core.avatar.spec import BLOCKS
from pica_core.avatar.storage import DEFAULT_STORAGE, Storage
from pica_core.camera import Camera
from pica_core.gl import create_context, wait_for_gpu
from pica_core.types import BoolArray, FloatArray, Image

SAMPLES = 3
"""Of the truth, along each side of a pixel."""
WARM_UP_FRAMES = 2
SAME_COST = 0.05
"""Costs closer than this share are taken to be the same."""
PRECISIONS: tuple[Storage, ...] = ("f32", "f16", "u8")


@dataclass(frozen=True, kw_only=True, slots=True)
class ParetoBenchConfig:
    """What to measure."""

    distances_cm: tuple[float, ...] = (18.0, 65.0, 120.0)
    image_size: int = 768
    """Rows and columns of the image, pixels."""
    frames: int = 16
    """Of each contender, 30 a second."""
    performance: str = "talk"
    start_s: float = 3.0
    """Where in it the frames begin."""

    def __post_init__(self) -> None:
        check_distances(self.distances_cm)
        for name, low, high in (("image_size", 64, 2048), ("frames", 3, 1000)):
            if not low <= getattr(self, name) <= high:
                raise OptionError(f"{name} is {getattr(self, name)}; {low} to {high} is allowed")


@dataclass(slots=True, eq=False)
class _Contender:
    """One way to show the face."""

    model: str
    level: int
    mesh: int
    precision: str
    distance_cm: float
    decoder: OnnxDecoder
    is_judged: bool
    file_bytes: int | None
    decode_s: list[float] = field(default_factory=list)
    draw_s: list[float] = field(default_factory=list)
    mse: list[float] = field(default_factory=list)
    change_mse: list[float] = field(default_factory=list)
    shown: tuple[Image, BoolArray] | None = None


def run_pareto_bench(
    config: ParetoBenchConfig,
    avatar: Avatar,
    progress: Callable[[float], None] = lambda ratio: None,
) -> dict[str, Any]:
    """Measure.

    Args:
        config: What.
        avatar: Whose face.
        progress: LayerSubscription how much is done, 0 to 1.

    Raises:
        GraphicsError: No GL context.
    """
    context = create_context()
    try:
        bench = _Bench(context, config, avatar)
        rows = bench.run(progress)
        return {
            "avatar": avatar.manifest.identity,
            "gl_renderer": bench.gl_renderer,
            "image_size": config.image_size,
            "frames": config.frames,
            "performance": config.performance,
            "rows": mark_best(rows),
            "machine": describe_machine(),
        }
    finally:
        context.release()


class _Bench:
    def __init__(
        self, context: moderngl.Context, config: ParetoBenchConfig, avatar: Avatar
    ) -> None:
        self._context, self._config, self._avatar = context, config, avatar
        # Edges that are smoothed belong to the display, and would hide errors of silhouettes.
        options = RenderOptions(smooth_edges=False)
        size = config.image_size
        self._renderer = Renderer(context, (size, size), options)
        self._renderer.add_avatar("head", avatar)
        self._fine = Renderer(context, (size * SAMPLES, size * SAMPLES), options)
        self._fine.add_avatar("head", avatar)
        self._truth_decoder = OnnxDecoder(avatar)
        self.gl_renderer = self._renderer.gl_renderer
        self._contenders = self._make_contenders()

    def run(self, progress: Callable[[float], None]) -> list[dict[str, Any]]:
        """Show all frames in all ways."""
        config, encoder = self._config, ExpressionEncoder(self._avatar)
        truths: dict[float, tuple[Image, BoolArray]] = {}
        count = WARM_UP_FRAMES + config.frames
        talk = talk_frames(config.performance, config.start_s, WARM_UP_FRAMES, config.frames)
        for index, (arkit, matrix) in enumerate(talk):
            latent = encoder.encode(arkit)
            before, truths = truths, {}
            for distance in config.distances_cm:
                truths[distance] = self._truth(latent, matrix, distance)
            for contender in self._contenders:
                self._show(contender, latent, matrix, index >= WARM_UP_FRAMES, truths, before)
            progress((index + 1) / count)
        return [_row(contender) for contender in self._contenders]

    def _make_contenders(self) -> list[_Contender]:
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
            _Contender(model, level, mesh, precision, distance, decoder, is_judged, file_bytes)
            for distance in self._config.distances_cm
            for model, precision, decoder, is_judged, file_bytes, levels in found
            for level in levels
            for mesh in avatar.levels
            # Fewer triangles cost and lose the same whatever the weights were stored as.
            if mesh == level or (model, precision, level) == ("pica", "f32", full)
        ]

    def _show(
        self,
        contender: _Contender,
        latent: FloatArray,
        matrix: FloatArray,
        is_measured: bool,
        truths: dict[float, tuple[Image, BoolArray]],
        before: dict[float, tuple[Image, BoolArray]],
    ) -> None:
        """Decode and draw one frame, and compare it with the truth."""
        distance = contender.distance_cm
        camera = self._camera(distance, self._config.image_size)
        direction = view_direction(matrix, camera.centre_m)
        begin_s = time.perf_counter()
        maps = contender.decoder.decode(latent, direction, contender.level)
        decoded_s = time.perf_counter()
        if not contender.is_judged:  # random weights make no face; what they cost to draw is known
            if is_measured:
                contender.decode_s.append(decoded_s - begin_s)
            return
        self._renderer.update_maps("head", maps.position_map, maps.expression_map)
        placement = Placement(slot="head", world_from_head=matrix, mesh_level=contender.mesh)
        drawing_s = time.perf_counter()
        self._renderer.draw([placement], camera)
        wait_for_gpu(self._context)
        drawn_s = time.perf_counter()
        shown = _read(self._renderer)
        if is_measured:
            contender.decode_s.append(decoded_s - begin_s)
            contender.draw_s.append(drawn_s - drawing_s)
            truth, is_truth = truths[distance]
            contender.mse.append(masked_mse(shown[0], truth, shown[1] | is_truth))
            if contender.shown is not None and distance in before:
                contender.change_mse.append(
                    _change_mse(contender.shown, shown, before[distance], truths[distance])
                )
        contender.shown = shown

    def _truth(
        self, latent: FloatArray, matrix: FloatArray, distance_cm: float
    ) -> tuple[Image, BoolArray]:
        size = self._config.image_size
        camera = self._camera(distance_cm, size * SAMPLES)
        maps = self._truth_decoder.decode(latent, view_direction(matrix, camera.centre_m))
        self._fine.update_maps("head", maps.position_map, maps.expression_map)
        self._fine.draw([Placement(slot="head", world_from_head=matrix)], camera)
        image, covered = _read(self._fine)
        cells = image.reshape(size, SAMPLES, size, SAMPLES, 3).astype(np.float32)
        mean = np.rint(cells.mean(axis=(1, 3))).astype(np.uint8)
        share = covered.reshape(size, SAMPLES, size, SAMPLES).mean(axis=(1, 3))
        return mean, share >= 0.5

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

    judged = [row for row in rows if row["mse"] is not None]
    for row in rows:
        rivals = [each for each in judged if each["distance_cm"] == row["distance_cm"]]
        row["is_best"] = row["mse"] is not None and not any(beats(each, row) for each in rivals)
    return rows


def _row(contender: _Contender) -> dict[str, Any]:
    decode_s = median(contender.decode_s)
    draw_s = median(contender.draw_s) if contender.draw_s else math.nan
    is_judged = contender.is_judged
    return {
        "model": contender.model,
        "level": contender.level,
        "mesh": contender.mesh,
        "precision": contender.precision,
        "file_bytes": contender.file_bytes,
        "distance_cm": contender.distance_cm,
        "decode_ms": round(decode_s * 1e3, 3),
        "draw_ms": round(draw_s * 1e3, 3) if is_judged else None,
        "total_ms": round((decode_s + draw_s) * 1e3, 3) if is_judged else None,
        "mse": round(float(np.mean(contender.mse)), 4) if is_judged else None,
        "change_mse": round(float(np.mean(contender.change_mse)), 4) if is_judged else None,
    }


def _change_mse(
    shown_before: tuple[Image, BoolArray],
    shown: tuple[Image, BoolArray],
    truth_before: tuple[Image, BoolArray],
    truth: tuple[Image, BoolArray],
) -> float:
    """The error of the change between two frames, over what any of the four pictures covers."""
    where = shown_before[1] | shown[1] | truth_before[1] | truth[1]
    if not where.any():
        return 0.0
    changed = shown[0][where].astype(np.float32) - shown_before[0][where]
    should = truth[0][where].astype(np.float32) - truth_before[0][where]
    return float(np.square(changed - should).mean())


def _read(renderer: Renderer) -> tuple[Image, BoolArray]:
    return renderer.read_image(), renderer.read_surface()[2] >= 0
