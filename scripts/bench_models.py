"""Error against milliseconds for trained models: the rows of the paper's tables, and blocks.

    python scripts/bench_models.py exported --rows table1.txt table2.txt

The last line of stdout is the result, one JSON object; ``docs/benches.md`` says what its fields
mean. The error is not measured here: it is the held-out MSE that `pica eval` measured of the same
models, by the model's own encoder, and comes in with its rows. The interval of an error over
several views is the mean of the views' own: no narrower than the true one, and hardly wider.

Set LP_NUM_THREADS to say how many threads software GL takes.
"""

from __future__ import annotations

import json
import math
import os
import sys
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import quantiles
from typing import Any, NamedTuple

import moderngl
import safetensors
import tyro
from tyro.conf import OmitArgPrefixes, Positional

from pica_client.bench.harness import Took, gl_context, median_ms, take_turns, timed
from pica_client.bench.head import (
    Bounded,
    check_distances,
    front_camera,
    talk_frames,
)
from pica_client.bench.option_types import Floats
from pica_client.bench.pareto import mark_best
from pica_client.decode.decoder import BaselineDecoder, OnnxDecoder, OnnxOptions
from pica_client.decode.onnx_runtime import onnxruntime
from pica_client.errors import OptionError, check_ranges
from pica_client.render.draw_list import DrawStats
from pica_client.render.renderer import Renderer
from pica_client.render.scene import Placement, view_direction
from pica_client.stats import describe_machine
from pica_core.avatar.baseline import KEY as BASELINE_KEY
from pica_core.avatar.baseline import BaselineAvatar, load_baseline
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar, load_avatar
from pica_core.avatar.variants import VARIANTS, ModelCost, pixel_codec_cost
from pica_core.camera import Camera
from pica_core.gl import wait_for_gpu
from pica_core.types import FloatArray

BASELINE = "baseline"
"""Its row of the paper's tables."""
WARM_UP_FRAMES = 2
PARTS = ("decode", "upload", "draw", "total")
MEANS = ("mse", "mse_low", "mse_high", "psnr_db", "ssim")
"""Fields of `pica eval` of which an error has the mean over views."""

Row = dict[str, Any]


class ModelKey(NamedTuple):
    """Which model of whom.

    Attributes:
        identity: Who was captured.
        variant: Row of the paper's tables.
        block: Of the per-object decoders; None where there are none.
    """

    identity: str
    variant: str
    block: str | None

    def __str__(self) -> str:
        block = "" if self.block is None else f" with block {self.block}"
        return f"{self.identity} {self.variant}{block}"


def held_out_errors(rows: Iterable[Row]) -> dict[ModelKey, Row]:
    """What each model leaves on held-out frames, means over views, as `pica eval` measured it.

    Args:
        rows: One for each model and view; of two about the same one the later counts.

    Raises:
        OptionError: A row lacks a field, or rows of a model are of several runs.
    """
    by_model: dict[ModelKey, dict[str, Row]] = {}
    try:
        for row in rows:
            key = ModelKey(row["identity"], row["variant"], row["block"])
            by_view = by_model.setdefault(key, {})
            if any(row["seed"] != other["seed"] for other in by_view.values()):
                raise OptionError(f"rows: {key} was trained with several seeds; leave one's rows")
            by_view[row["view"]] = row
        return {key: _mean_error(list(rows.values())) for key, rows in by_model.items()}
    except (KeyError, TypeError) as error:
        raise OptionError(f"rows: {error} is missing or wrong; measure with `pica eval`") from error


def _mean_error(rows: Sequence[Row]) -> Row:
    frames = {row.get("frames") for row in rows}
    return {
        **{name: math.fsum(row[name] for row in rows) / len(rows) for name in MEANS},
        "views": len(rows),
        "frames": frames.pop() if len(frames) == 1 else None,
        **{name: int(rows[0][name]) for name in ("parameters", "steps", "seed")},
    }


def read_rows(path: Path) -> Iterator[Row]:
    """Rows of what ``pica eval --json`` prints, of its ``eval.json``, or of recorded lines.

    Raises:
        OptionError: There are none in the file.
    """
    text = path.read_text()
    try:
        values = [json.loads(text)]
    except ValueError:  # tables stand above
        values = [json.loads(line) for line in text.splitlines() if line.startswith("{")]
    if not values:
        raise OptionError(f"{path}: no JSON in it; `pica eval --json` prints some")
    for value in values:
        yield from value.get("result", value)["rows"]


class Model(ABC):
    """A trained model as a receiver runs it: file, cost, where its head is, and its encoder."""

    def __init__(
        self, key: ModelKey, path: Path, cost: ModelCost, weights: Avatar | BaselineAvatar
    ) -> None:
        self.key, self.file_bytes, self.cost = key, path.stat().st_size, cost
        self.box: Bounded = weights.manifest if isinstance(weights, Avatar) else weights
        self.encoder = ExpressionEncoder(weights)

    @abstractmethod
    def stage(self, renderer: Renderer, slot: str, onnx: OnnxOptions) -> None:
        """Get ready to be decoded, and to be drawn in a slot of a renderer."""

    @abstractmethod
    def decode(self, latent: FloatArray, direction: FloatArray) -> None:
        """Decode a latent and keep what comes of it."""

    @abstractmethod
    def upload(self, renderer: Renderer, slot: str) -> None:
        """Hand the renderer, at the slot of `stage`, what was decoded last."""


class CodecModel(Model):
    """An avatar, at its full level."""

    def __init__(self, path: Path) -> None:
        avatar = self._avatar = load_avatar(path)
        key = ModelKey(avatar.manifest.identity, avatar.manifest.variant, avatar.spec.block)
        super().__init__(key, path, pixel_codec_cost(avatar.spec), avatar)

    def stage(self, renderer: Renderer, slot: str, onnx: OnnxOptions) -> None:
        """Open the decoder of both maps, and give the avatar to the renderer."""
        self._decoder = OnnxDecoder(self._avatar, onnx)
        renderer.add_avatar(slot, self._avatar)

    def decode(self, latent: FloatArray, direction: FloatArray) -> None:
        """Decode both maps."""
        self._maps = self._decoder.decode(latent, direction)

    def upload(self, renderer: Renderer, slot: str) -> None:
        """Hand both maps over."""
        renderer.update_maps(slot, self._maps.position_map, self._maps.expression_map)


class TexturedModel(Model):
    """A baseline.

    Raises:
        OptionError: Its file has no expression encoder.
    """

    def __init__(self, path: Path, identity: str) -> None:
        baseline = self._baseline = load_baseline(path)
        if "encoder.0.weight" not in baseline.tensors:
            raise OptionError(f"{path}: this baseline has no expression encoder; export it again")
        spec = baseline.spec
        cost = ModelCost(
            parameters=spec.num_parameters,
            per_object_multiply_adds=spec.multiply_adds,
            per_pixel_multiply_adds=0,
        )
        super().__init__(ModelKey(identity, BASELINE, None), path, cost, baseline)

    def stage(self, renderer: Renderer, slot: str, onnx: OnnxOptions) -> None:
        """Open the decoder of mesh and texture, and give the mesh's topology to the renderer."""
        self._decoder = BaselineDecoder(self._baseline, onnx)
        renderer.add_textured(slot, self._baseline)

    def decode(self, latent: FloatArray, direction: FloatArray) -> None:
        """Decode mesh and texture."""
        self._maps = self._decoder.decode(latent, direction)

    def upload(self, renderer: Renderer, slot: str) -> None:
        """Hand mesh and texture over."""
        renderer.update_textured(slot, self._maps.vertices_m, self._maps.texture)


def open_models(names: Sequence[str]) -> list[Model]:
    """Read avatars and baselines.

    Args:
        names: Files, or folders for all ``.pica`` files in them. A baseline's file does not say
            whom it shows: that is the one person of all avatars here, or written before its name,
            ``IDENTITY=FILE``.

    Returns:
        Models by person, in the order of the paper's tables.

    Raises:
        OptionError: No files, two of the same model, or a baseline without a person.
        AvatarFileError: A file that is neither an avatar nor a baseline.
    """
    files = [found for name in names for found in _files(name)]
    avatars = [(CodecModel(path), path, who) for path, who in files if not _is_baseline(path)]
    for model, path, identity in avatars:
        if identity not in (None, model.key.identity):
            raise OptionError(f"{path}: shows {model.key.identity}, not {identity}")
    people = sorted({model.key.identity for model, _, _ in avatars})
    models: list[Model] = [model for model, _, _ in avatars]
    for path, identity in files:
        if not _is_baseline(path):
            continue
        if identity is None and len(people) != 1:
            raise OptionError(
                f"{path}: a baseline's file does not say whom it shows; write IDENTITY={path}"
            )
        models.append(TexturedModel(path, identity or people[0]))
    if not models:
        raise OptionError("files is empty; name at least one that `pica export` wrote")
    for key, count in Counter(model.key for model in models).items():
        if count > 1:
            raise OptionError(f"files: {key} is there twice")
    return sorted(models, key=_place)


def _place(model: Model) -> tuple[str, int, str]:
    """What models are sorted by: the person, then the order of the paper's tables."""
    identity, variant, block = model.key
    return identity, list(VARIANTS).index(variant), block or ""


def _files(name: str) -> list[tuple[Path, str | None]]:
    """Path and stated identity of what a word of the command line means."""
    identity, sign, rest = name.partition("=")
    if not sign or Path(name).exists():
        identity, rest = "", name
    path = Path(rest)
    if not path.is_dir():
        return [(path, identity or None)]
    found = sorted(path.glob("*.pica"))
    if not found:
        raise OptionError(f"{path}: no .pica files in this folder")
    return [(file, identity or None) for file in found]


def _is_baseline(path: Path) -> bool:
    """Whether a file says that it is one; what is no such file at all, `load_avatar` refuses."""
    try:
        with safetensors.safe_open(path, "numpy") as file:
            return BASELINE_KEY in (file.metadata() or {})
    except (OSError, safetensors.SafetensorError):
        return False


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


def join_errors(models: Sequence[Model], errors: dict[ModelKey, Row]) -> list[Row]:
    """The held-out error of each model.

    Raises:
        OptionError: There is none, it is of a model of another size, or two of one person were
            measured on different views or frames.
    """
    protocols: dict[str, tuple[int, int | None]] = {}
    for model in models:
        key, error = model.key, errors.get(model.key)
        if error is None:
            known = ", ".join(sorted(map(str, errors))) or "none"
            raise OptionError(f"rows: no error of {key}; there are {known}")
        if error["parameters"] != model.cost.parameters:
            raise OptionError(
                f"rows: {key} has {error['parameters']} parameters, its file "
                f"{model.cost.parameters}: they are not of one model"
            )
        protocol = error["views"], error["frames"]
        if protocols.setdefault(key.identity, protocol) != protocol:
            raise OptionError(
                f"rows: {key} was measured in {error['views']} views of {error['frames']} frames, "
                f"others of {key.identity} otherwise; measure all alike"
            )
    return [errors[model.key] for model in models]


def run_models_bench(
    config: ModelsBenchConfig, models: Sequence[Model], errors: Sequence[Row]
) -> dict[str, Any]:
    """Measure.

    Args:
        config: What.
        models: Of whom, from `open_models`.
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

    def run(self, errors: Sequence[Row]) -> tuple[list[dict[str, Any]], list[int]]:
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
                    "mse": round(errors[case.number]["mse"], 4),
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


def _describe(model: Model, error: Row, triangles: int) -> dict[str, Any]:
    cost = model.cost
    return {
        **model.key._asdict(),
        "file_bytes": model.file_bytes,
        **{name: round(x, 4) if isinstance(x, float) else x for name, x in error.items()},
        "parameters": cost.parameters,
        "macs": cost.per_object_multiply_adds,
        "macs_per_pixel": cost.per_pixel_multiply_adds,
        "triangles": triangles,
    }


@dataclass(frozen=True, kw_only=True, slots=True)
class Options:
    """Which models, with which errors."""

    files: Positional[tuple[str, ...]]
    """What `pica export` wrote, or folders of it. A baseline's file does not say whom it shows;
    where avatars of several people are measured, write IDENTITY=FILE."""
    rows: tuple[Path, ...]
    """What `pica eval --json` printed of the same models, or recorded lines of it."""
    config: OmitArgPrefixes[ModelsBenchConfig]


def main() -> None:
    """Measure, and print a line for each model and distance."""
    options = tyro.cli(Options, description=__doc__)
    errors = held_out_errors(row for path in options.rows for row in read_rows(path))
    models = open_models(options.files)
    result = run_models_bench(options.config, models, join_errors(models, errors))
    for row in result["rows"]:
        print(
            f"{row['distance_cm']:5g} cm  {row['identity']:4} {row['variant']:9}"
            f"{row['block'] or '':3} {row['pixels']:8d} px  decode {row['decode_ms']:7.2f} ms  "
            f"draw {row['draw_ms']:7.2f} ms  total {row['total_ms']:7.2f} ms  "
            f"MSE {row['mse']:7.2f} {'best' if row['is_best'] else ''}",
            file=sys.stderr,
        )
    print(json.dumps(result))


if __name__ == "__main__":
    main()
