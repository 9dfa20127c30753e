"""What one head costs: decoding it at every level and drawing it near and far, beside the paper's
baseline.

The layout of the drawings is that of the paper's Table 3: one head before a square eye buffer. A
drawing is all that the viewer draws but texts; reading the image back is not in it. What it does
not show: several heads (`pica bench scene`), decoding in shaders.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import moderngl
import numpy as np

from pica_client.bench.harness import (
    front_camera,
    gl_context,
    ratio,
    report,
    take_turns,
    timed,
    times_ms,
)
from pica_client.decode.decoder import BaselineDecoder, OnnxDecoder, onnxruntime
from pica_client.decode.request import Parts
from pica_client.errors import check_ranges
from pica_client.render.drawing import HEAD
from pica_client.render.renderer import Renderer
from pica_client.render.scene import Placement
from pica_client.sources import open_source
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.gl import wait_for_gpu
from pica_core.reference import baseline_like
from pica_core.types import FloatArray

NUM_LATENTS = 16
"""Faces decoded in turn, spread over the source (chosen: the cost does not depend on them)."""
SOURCE, SOURCE_S = "performance:talk", 30.0
WARM_UP_ROUNDS = 3
DISTANCES_CM = (18.0, 65.0, 120.0)
"""Of the camera from the front of the head."""
AHEAD = np.array([0, 0, 1], np.float32)


@dataclass(frozen=True, kw_only=True, slots=True)
class DecodeBenchConfig:
    """What is measured."""

    rounds: int = 60
    """Turns of each case."""
    threads: int = 1
    """Threads of ONNX Runtime."""
    image_size: int = 1024
    """Rows and columns of the image, pixels."""

    def __post_init__(self) -> None:
        check_ranges(self, rounds=(1, 10_000), threads=(1, 64), image_size=(64, 4096))


class Case(NamedTuple):
    """Something that is measured; fields that do not apply are None."""

    work: str
    """decode or draw."""
    model: str
    level: int | None
    parts: str | None = None
    distance_cm: float | None = None


Work = Callable[[FloatArray], object]


def run_decode_bench(config: DecodeBenchConfig, avatar: Avatar) -> dict[str, Any]:
    """Measure an avatar's decoders and the drawing of its head.

    Raises:
        GraphicsError: No GL context.
    """
    with gl_context() as context:
        bench = _Bench(context, config, avatar)
        works = dict(bench.cases())
        source, encoder = open_source(SOURCE), ExpressionEncoder(avatar)
        times_s = np.linspace(0, SOURCE_S, NUM_LATENTS, endpoint=False).tolist()
        latents = [encoder.encode(source.frame_at(time_s).arkit) for time_s in times_s]

        def turn(case: Case, number: int) -> float:
            return timed(works[case], latents[number % len(latents)])[0]

        samples = take_turns(list(works), turn, rounds=config.rounds, warm_up=WARM_UP_ROUNDS)
        took = dict(zip(works, samples, strict=True))
        baseline_s = took[Case("decode", "baseline", None)]
        whole = [case for case in took if case.parts == "both"]
        return report(
            config,
            [bench.row(case, took) for case in took],
            baseline_ratio={str(case.level): ratio(baseline_s, took[case]) for case in whole},
            avatar=avatar.manifest.name,
            block=avatar.spec.block,
            gl_renderer=bench.renderer.gl_renderer,
            gl_threads=os.environ.get("LP_NUM_THREADS"),
            onnxruntime=onnxruntime.__version__,
        )


class _Bench:
    """The head and its baseline in one renderer."""

    def __init__(
        self, context: moderngl.Context, config: DecodeBenchConfig, avatar: Avatar
    ) -> None:
        self._context, self._config, self._avatar = context, config, avatar
        self._baseline = baseline_like(avatar, 0)
        self.renderer = Renderer(context, (config.image_size, config.image_size))

    def cases(self) -> Iterator[tuple[Case, Work]]:
        """Every level and the baseline, decoded, and drawn so far away."""
        all_parts: tuple[Parts, ...] = ("both", "expression")
        decoder = OnnxDecoder(self._avatar, self._config.threads)
        baseline = BaselineDecoder(self._baseline, self._config.threads)
        for level in self._avatar.levels:
            for parts in all_parts:
                decoder.prepare(level, parts)
                yield Case("decode", "pica", level, parts), partial(_decode, decoder, level, parts)
        yield Case("decode", "baseline", None), partial(_decode, baseline)
        self._upload(decoder, baseline)
        for distance in DISTANCES_CM:
            for drawn in (*self._avatar.levels, None):
                model = "baseline" if drawn is None else "pica"
                draw = partial(self._draw, _slot(drawn), distance)
                yield Case("draw", model, drawn, distance_cm=distance), draw

    def row(self, case: Case, took: dict[Case, list[float]]) -> dict[str, Any]:
        """What a case took, and what it drew."""
        found: dict[str, Any] = case._asdict() | times_ms(took[case])
        found |= dict.fromkeys(("pixels", "triangles", "over_baseline"))
        if case.distance_cm is not None:
            self.renderer.forget_frame()
            camera = self._camera(case.distance_cm)
            stats = self.renderer.draw([_placed(_slot(case.level))], camera, count_pixels=True)
            found["pixels"] = stats.shaded_pixels or stats.textured_pixels
            found["triangles"] = stats.num_triangles
            baseline = case._replace(model="baseline", level=None)
            found["over_baseline"] = ratio(took[case], took[baseline])
        return found

    def _upload(self, decoder: OnnxDecoder, baseline: BaselineDecoder) -> None:
        """Put the resting face of every level on the GPU."""
        rest = np.zeros((8, 8, 4), np.float32)
        for level in self._avatar.levels:
            self.renderer.add_avatar(_slot(level), self._avatar)
            maps = decoder.decode(rest, AHEAD, level)
            self.renderer.update_maps(_slot(level), maps.position_map, maps.expression_map)
        self.renderer.add_textured(_slot(None), self._baseline)
        decoded = baseline.decode(rest, AHEAD)
        self.renderer.update_textured(_slot(None), *decoded)

    def _draw(self, slot: str, distance_cm: float, _latent: FloatArray) -> None:
        self.renderer.forget_frame()
        self.renderer.draw([_placed(slot)], self._camera(distance_cm))
        wait_for_gpu(self._context)

    def _camera(self, distance_cm: float) -> Any:
        size = self._config.image_size, self._config.image_size
        return front_camera(self._avatar.manifest, distance_cm, size)


def _slot(level: int | None) -> str:
    return "baseline" if level is None else f"pica-{level}"


def _placed(slot: str) -> Placement:
    return Placement(slot=slot, world_from_head=HEAD)


def _decode(decoder: OnnxDecoder | BaselineDecoder, *arguments: Any) -> object:
    *chosen, latent = arguments
    return decoder.decode(latent, AHEAD, *chosen)
