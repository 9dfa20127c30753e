"""Error against milliseconds for trained models: the rows of the paper's tables, and blocks.

The error is not measured here: it is the held-out MSE that `pica eval` measured of the same models,
by the model's own encoder, and comes in with its rows (`eval_rows`).

The fields of its rows stand in ``docs/benches.md``. What it does not show: levels of detail (`pica
bench pareto`), what the file's rounding adds to the error (`pica avatar precision`), and caches
that are warm from the frame before: whoever else is measured in between has emptied them.
"""

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from statistics import quantiles
from typing import Any, NamedTuple

import moderngl

from pica_client.bench.eval_rows import EvalRows, HeldOutError
from pica_client.bench.harness import Took, gl_context, median_ms, take_turns, timed
from pica_client.bench.head import check_distances, front_camera, talk_frames
from pica_client.bench.model_files import Model
from pica_client.bench.option_types import Floats, check_ranges
from pica_client.bench.pareto import mark_best
from pica_client.decode.decoder import OnnxOptions
from pica_client.decode.onnx_runtime import onnxruntime
from pica_client.errors import OptionError
from pica_client.render.draw_list import DrawStats
from pica_client.render.renderer import Renderer
from pica_client.render.scene import Placement, view_direction
from pica_client.stats import describe_machine
from pica_core.camera import Camera
from pica_core.gl import wait_for_gpu
from pica_core.types import FloatArray

WARM_UP_FRAMES = 2
PARTS = ("decode", "upload", "draw", "total")


@dataclass(frozen=True, kw_only=True, slots=True)
class ModelsBenchConfig:
    """What to measure."""

    distances_cm: Floats = (18.0, 65.0, 120.0)
    """Distances of the camera from the front of the head, separated by commas."""
    image_size: int = 768
    """Rows and columns of the image, pixels."""
    frames: int = 30
    """Frames of each model at each distance, 30 a second."""
    threads: int = 1
    """Threads of ONNX Runtime."""
    performance: str = "talk"
    """What the heads do: talk, listen or range-of-motion."""
    start_s: float = 3.0
    """Second of it at which the frames begin."""
    seed: int = 0
    """Seed of the order of turns."""

    def __post_init__(self) -> None:
        check_distances(self.distances_cm)
        check_ranges(self, image_size=(64, 4096), frames=(3, 1000), threads=(1, 64))


def join_errors(models: Sequence[Model], rows: EvalRows) -> list[HeldOutError]:
    """The held-out error of each model.

    Raises:
        OptionError: There is none, it is of a model of another size, or two of one person were
            measured on different views or frames.
    """
    errors: list[HeldOutError] = []
    protocols: dict[str, tuple[int, int | None]] = {}
    for model in models:
        key, error = model.key, rows.error_of(model.key)
        if error.parameters != model.cost.parameters:
            raise OptionError(
                f"rows: {key} has {error.parameters} parameters, its file {model.cost.parameters}: "
                "they are not of one model"
            )
        protocol = error.views, error.frames
        if protocols.setdefault(key.identity, protocol) != protocol:
            raise OptionError(
                f"rows: {key} was measured in {error.views} views of {error.frames} frames, others "
                f"of {key.identity} otherwise; measure all alike"
            )
        errors.append(error)
    return errors


def run_models_bench(
    config: ModelsBenchConfig, models: Sequence[Model], errors: Sequence[HeldOutError]
) -> dict[str, Any]:
    """Measure.

    Args:
        config: What.
        models: Of whom, from `model_files.open_models`.
        errors: Theirs, from `join_errors`.

    Raises:
        GraphicsError: No GL context.
    """
    with gl_context() as context:
        bench = _Bench(context, config, models)
        rows, triangles = bench.run(errors)
        return {
            "gl_renderer": bench.gl_renderer,
            "gl_threads": os.environ.get("LP_NUM_THREADS"),
            "image_size": config.image_size,
            "frames": config.frames,
            "threads": config.threads,
            "performance": config.performance,
            "models": [_describe(*each) for each in zip(models, errors, triangles, strict=True)],
            "rows": rows,
            "machine": describe_machine() | {"onnxruntime": onnxruntime.__version__},
        }


class _Case(NamedTuple):
    """One model, by its number, at one distance."""

    number: int
    distance_cm: float

    @property
    def slot(self) -> str:
        """Where the renderer has the model."""
        return f"model-{self.number}"


class _Bench:
    def __init__(
        self, context: moderngl.Context, config: ModelsBenchConfig, models: Sequence[Model]
    ) -> None:
        self._context, self._config, self._models = context, config, models
        self._renderer = Renderer(context, (config.image_size, config.image_size))
        self.gl_renderer = self._renderer.gl_renderer
        onnx = OnnxOptions(threads=config.threads)
        numbers = range(len(models))
        self._cases = [_Case(n, distance) for n in numbers for distance in config.distances_cm]
        for number, model in enumerate(models):
            model.stage(self._renderer, _Case(number, 0).slot, onnx)

    def run(self, errors: Sequence[HeldOutError]) -> tuple[list[dict[str, Any]], list[int]]:
        """Show all frames in all ways; a row for each case, and each model's triangles."""
        config = self._config
        talk = talk_frames(config.performance, config.start_s, WARM_UP_FRAMES, config.frames)
        shown = [
            ([model.encoder.encode(arkit) for model in self._models], matrix)
            for arkit, matrix in talk
        ]

        def show(case: _Case, number: int) -> dict[str, Took]:
            latents, matrix = shown[number + WARM_UP_FRAMES]
            return self._show(case, latents[case.number], matrix)

        times = take_turns(
            self._cases, show, rounds=config.frames, warm_up=WARM_UP_FRAMES, seed=config.seed
        )
        rows: list[dict[str, Any]] = []
        triangles = [0] * len(self._models)
        for case, frames in zip(self._cases, times, strict=True):
            stats = self._draw(case, shown[-1][1], count_pixels=True)
            triangles[case.number] = stats.num_triangles
            rows.append(
                {
                    **self._models[case.number].key._asdict(),
                    "distance_cm": case.distance_cm,
                    "pixels": sum(head.shaded_pixels or 0 for head in stats.heads),
                    **_times(frames),
                    "mse": round(errors[case.number].mse, 4),
                }
            )
        for identity in dict.fromkeys(row["identity"] for row in rows):
            mark_best([row for row in rows if row["identity"] == identity])
        return rows, triangles

    def _show(self, case: _Case, latent: FloatArray, matrix: FloatArray) -> dict[str, Took]:
        """Decode and draw one frame."""
        model = self._models[case.number]
        direction = view_direction(matrix, self._camera(case).centre_m)
        decoded, _ = timed(model.decode, latent, direction)
        uploaded, _ = timed(model.upload, self._renderer, case.slot)
        drawn, _ = timed(self._draw, case, matrix)
        total = Took(decoded.wall_s + drawn.wall_s, decoded.cpu_s + drawn.cpu_s)
        return dict(zip(PARTS, (decoded, uploaded, drawn, total), strict=True))

    def _draw(self, case: _Case, matrix: FloatArray, *, count_pixels: bool = False) -> DrawStats:
        placement = Placement(slot=case.slot, world_from_head=matrix)
        stats = self._renderer.draw([placement], self._camera(case), count_pixels=count_pixels)
        wait_for_gpu(self._context)
        return stats

    def _camera(self, case: _Case) -> Camera:
        size = self._config.image_size
        return front_camera(self._models[case.number].box, case.distance_cm, (size, size))


def _times(frames: Sequence[dict[str, Took]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for part in PARTS:
        walls_s = [took[part].wall_s for took in frames]
        low, _, high = quantiles(walls_s, n=4, method="inclusive")
        found[f"{part}_ms"] = median_ms(walls_s)
        found[f"{part}_ms_low"] = round(low * 1e3, 3)
        found[f"{part}_ms_high"] = round(high * 1e3, 3)
        found[f"{part}_cpu_ms"] = median_ms([took[part].cpu_s for took in frames])
    return found


def _describe(model: Model, error: HeldOutError, triangles: int) -> dict[str, Any]:
    cost, means = model.cost, asdict(error)
    return {
        **model.key._asdict(),
        "file_bytes": model.file_bytes,
        **{name: round(x, 4) if isinstance(x, float) else x for name, x in means.items()},
        "parameters": cost.parameters,
        "macs": cost.per_object_multiply_adds,
        "macs_per_pixel": cost.per_pixel_multiply_adds,
        "triangles": triangles,
    }
