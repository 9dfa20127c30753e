"""What drawing a head costs: near and far, at every level, beside a textured baseline.

The fields of its rows stand in ``docs/benches.md``. What it does not show: decoding and uploads
(`pica bench decode`), several heads, window systems.
"""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import moderngl
import numpy as np

from pica_client.bench.harness import Took, gl_context, median_ms, spread, take_turns, timed
from pica_client.bench.head import FIELD_OF_VIEW, check_distances, front_camera
from pica_client.bench.option_types import Floats
from pica_client.decode.decoder import OnnxDecoder
from pica_client.errors import check_ranges
from pica_client.render.drawing import HEAD
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, view_direction
from pica_client.stats import describe_machine
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.baseline import BaselineAvatar
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.camera import Camera
from pica_core.gl import wait_for_gpu
from pica_core.reference.baseline import baseline_like

Weights = Literal["auto", "block", "constants", "turns"]
WEIGHTS: tuple[Weights, ...] = get_args(Weights)
"""Places of the pixel decoder's weights, see `RenderOptions`."""
WARM_UP_FRAMES = 3
EXTRA_TIMES = 8
"""How many times more than once vertices are worked through to be timed."""
SWEEP_NEAREST_CM, SWEEP_FARTHEST_CM = 18.0, 400.0
TIMES = ("draw_ms", "draw_cpu_ms")


@dataclass(frozen=True, kw_only=True, slots=True)
class RenderBenchConfig:
    """What to measure."""

    distances_cm: Floats = (18.0, 65.0, 120.0)
    """Distances of the camera from the front of the head, separated by commas."""
    image_size: int = 1024
    """Rows and columns of the image, pixels."""
    rounds: int = 15
    """Frames drawn of each case."""
    sweep_points: int = 12
    """Distances of the sweep over pixels."""

    def __post_init__(self) -> None:
        check_ranges(self, image_size=(64, 4096), rounds=(3, 1000), sweep_points=(3, 100))
        check_distances(self.distances_cm)


class _Case(NamedTuple):
    """A model at one distance; level and mesh are 0 for the baseline."""

    model: str
    level: int
    mesh: int
    weights: str
    distance_cm: float


def run_render_bench(config: RenderBenchConfig, avatar: Avatar) -> dict[str, Any]:
    """Measure.

    Raises:
        GraphicsError: No GL context.
    """
    with gl_context() as context:
        bench = _Bench(context, config, avatar)
        rows, sweep = bench.measure(bench.table_cases()), bench.measure(bench.sweep_cases())
        lines = []
        for kind in dict.fromkeys((row["model"], row["level"]) for row in sweep):
            own = [row for row in sweep if (row["model"], row["level"]) == kind]
            for name in TIMES:
                lines.append(
                    {"model": kind[0], "level": kind[1], "time": name, **fit_line(own, name)}
                )
        return {
            "avatar": avatar.manifest.identity,
            "gl_renderer": bench.gl_renderer,
            "gl_threads": os.environ.get("LP_NUM_THREADS"),
            "image_size": config.image_size,
            "field_of_view_degrees": round(math.degrees(FIELD_OF_VIEW), 1),
            "rounds": config.rounds,
            "rows": rows,
            "sweep": sweep,
            "lines": lines,
            "summary": summarise(rows, lines, bench.weights),
            "machine": describe_machine(),
        }


class _Bench:
    """One renderer for each place of the weights, with the avatar at every level in it."""

    def __init__(
        self, context: moderngl.Context, config: RenderBenchConfig, avatar: Avatar
    ) -> None:
        self._context, self._config, self._avatar = context, config, avatar
        latent = ExpressionEncoder(avatar).encode(np.zeros(NUM_ARKIT, np.float32))
        direction = view_direction(HEAD, self._camera(100.0).centre_m)
        decoder, size = OnnxDecoder(avatar), (config.image_size, config.image_size)
        decoded = [decoder.decode(latent, direction, level) for level in avatar.levels]
        self._renderers: dict[str, Renderer] = {}
        for place in WEIGHTS:
            renderer = self._renderers[place] = Renderer(
                context, size, RenderOptions(weights=place)
            )
            for maps in decoded:
                slot = f"pica-{maps.level}"
                renderer.add_avatar(slot, avatar)
                renderer.update_maps(slot, maps.position_map, maps.expression_map)
        chosen = self._renderers["auto"]
        add_baseline(chosen, "baseline-0", baseline_like(avatar))
        self.gl_renderer, self.weights = chosen.gl_renderer, chosen.weights

    def table_cases(self) -> list[_Case]:
        """Every level, the full maps on every mesh, and the baseline at every distance; the full
        level also with its weights in other places."""
        levels = self._avatar.levels
        full = levels[-1]
        return [
            _Case(*variant, distance)
            for distance in self._config.distances_cm
            for variant in (
                *(("pica", level, level, "auto") for level in levels),
                *(("pica", full, mesh, "auto") for mesh in levels[:-1]),
                *(("pica", full, full, place) for place in WEIGHTS[1:] if place != self.weights),
                ("baseline", 0, 0, "auto"),
            )
        ]

    def sweep_cases(self) -> list[_Case]:
        """Every level and the baseline over distances whose pixels are spread evenly on a
        logarithmic scale."""
        distances = np.geomspace(SWEEP_NEAREST_CM, SWEEP_FARTHEST_CM, self._config.sweep_points)
        models = [*(("pica", level) for level in self._avatar.levels), ("baseline", 0)]
        return [
            _Case(model, level, level, "auto", round(float(distance), 1))
            for distance in distances
            for model, level in models
        ]

    def measure(self, cases: Sequence[_Case]) -> list[dict[str, Any]]:
        """Draw all cases in turns; a row for each."""
        rounds = self._config.rounds
        times = take_turns(cases, self._time, rounds=rounds, warm_up=WARM_UP_FRAMES)
        return [self._row(*each) for each in zip(cases, times, strict=True)]

    def _row(self, case: _Case, times: Sequence[tuple[Took, Took]]) -> dict[str, Any]:
        renderer, placements, camera = self._scene(case)
        stats = renderer.draw(placements, camera, count_pixels=True)
        frames, vertices = zip(*times, strict=True)
        return case._asdict() | {
            "weights": renderer.weights if case.model == "pica" else None,
            "pixels": sum(head.shaded_pixels or 0 for head in stats.heads),
            "triangles": stats.num_triangles,
            "draw_ms": median_ms([took.wall_s for took in frames]),
            "vertex_ms": median_ms([took.wall_s for took in vertices]),
            "draw_cpu_ms": median_ms([took.cpu_s for took in frames]),
            "vertex_cpu_ms": median_ms([took.cpu_s for took in vertices]),
            "spread": spread([took.wall_s for took in frames]),
        }

    def _time(self, case: _Case, _number: int) -> tuple[Took, Took]:
        """What a frame takes, and its vertices alone, drawn many times and once."""
        renderer, placements, camera = self._scene(case)

        def time(draw: Callable[[], object]) -> Took:
            def draw_and_wait() -> None:
                draw()
                wait_for_gpu(self._context)

            return timed(draw_and_wait)[0]

        frame = time(lambda: renderer.draw(placements, camera))
        many = time(lambda: renderer.draw_vertices(placements, camera, 1 + EXTRA_TIMES))
        once = time(lambda: renderer.draw_vertices(placements, camera))
        vertex = ((a - b) / EXTRA_TIMES for a, b in zip(many, once, strict=True))
        return frame, Took(*vertex)

    def _scene(self, case: _Case) -> tuple[Renderer, list[Placement], Camera]:
        placement = Placement(
            slot=f"{case.model}-{case.level}", world_from_head=HEAD, mesh_level=case.mesh or None
        )
        return self._renderers[case.weights], [placement], self._camera(case.distance_cm)

    def _camera(self, distance_cm: float) -> Camera:
        pixels = self._config.image_size
        return front_camera(self._avatar.manifest, distance_cm, (pixels, pixels))


def add_baseline(renderer: Renderer, slot: str, baseline: BaselineAvatar) -> None:
    """Put a baseline at rest into a renderer: what its decoder makes of a latent of zeros, but for
    the little that its random weights add."""
    last = len(baseline.spec.channels) - 1
    texture = baseline.tensors[f"texture.{last}.bias"].transpose(1, 2, 0)
    renderer.add_textured(slot, baseline)
    renderer.update_textured(
        slot,
        baseline.tensors["mesh.bias"].reshape(-1, 3).astype(np.float32),
        np.ascontiguousarray(texture, np.float32),
    )


def fit_line(rows: Sequence[dict[str, Any]], field: str = "draw_ms") -> dict[str, float]:
    """The least-squares line of a time over pixels.

    Returns:
        ``intercept_ms``, ``ns_per_pixel``, ``r2``, and ``worst_ms``, the largest distance of a row
        from the line.
    """
    pixels = np.array([row["pixels"] for row in rows], np.float64)
    times = np.array([row[field] for row in rows], np.float64)
    slope, intercept = np.polyfit(pixels, times, 1)
    left = times - (intercept + slope * pixels)
    total = float(np.square(times - times.mean()).sum())
    return {
        "intercept_ms": round(float(intercept), 3),
        "ns_per_pixel": round(float(slope) * 1e6, 3),
        "r2": round(1 - float(np.square(left).sum()) / total, 5) if total > 0 else 0.0,
        "worst_ms": round(float(np.abs(left).max()), 3),
    }


def summarise(
    rows: Sequence[dict[str, Any]], lines: Sequence[dict[str, Any]], weights: str
) -> dict[str, Any]:
    """The ratios that matter, per distance and level.

    Args:
        lines: Of every level and the baseline.
    """
    own = [row for row in rows if row["weights"] in (weights, None)]
    full = max(row["level"] for row in own)
    ratios: list[dict[str, Any]] = []
    for distance in sorted({row["distance_cm"] for row in own}):
        there = [row for row in own if row["distance_cm"] == distance]
        (baseline,) = (row for row in there if row["model"] == "baseline")
        (whole,) = (row for row in there if row["level"] == row["mesh"] == full)
        for row in there:
            if row["model"] != "pica":
                continue
            found = {name: row[name] for name in ("distance_cm", "level", "mesh")}
            for part, name, base in (("draw", "baseline", baseline), ("vertex", "full", whole)):
                for clock in ("", "cpu_"):
                    time = f"{part}_{clock}ms"
                    found[f"{part}_{clock}over_{name}"] = round(row[time] / base[time], 3)
            ratios.append(found)
    return {"ratios": ratios, "lines": lines}
