"""What a scene of several talking heads costs with and without the scheduler, and what error it
leaves.

Heads are in a line; each performs from another place in a shipped performance. A frame is all that
follows the latents: plan, decode, upload and draw, one after the other on one thread, so times add
up (the viewer decodes beside drawing). Each case has five frames a turn; times are means over a
turn, and of the turns the mean of the middle half. What it does not show: networks and playout
(`pica bench call`), windows, several threads.
"""

import math
import time
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import moderngl
import numpy as np

from pica_client.bench.harness import front_camera, gl_context, report, take_turns, timed
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.request import DecodeRequest, DecodeResult
from pica_client.errors import check_ranges
from pica_client.render.drawing import Drawing, drawn_mse, read_drawing
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, head_matrix, view_direction
from pica_client.schedule.head import Head
from pica_client.schedule.scheduler import Scheduler, requests_of
from pica_client.sources.source import make_performance
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.camera import Camera
from pica_core.gl import wait_for_gpu

SPACING_M = 0.25
"""Between two heads side by side (the paper's section 4.3)."""
FPS = 30.0
WARM_UP_FRAMES = 12
"""Frames of each case that do not count: costs are learned."""
TURN_FRAMES = 5
"""Frames of a case before the next one has its turn. The error of the last is measured: the maps of
the first are still those of the case before."""
DISTANCES_CM = (65.0, 90.0, 120.0)
"""Of the camera from the front of the middle head."""
BUDGETS_MS = (60.0, 40.0, 25.0)
"""Of a frame, with which the scheduler has the most heads, besides none: what error is left at what
cost."""
FULL_SCREEN_CM = 18.0
"""Where one head fills the screen; the paper's nearest distance."""
TIMES = ("plan", "decode", "upload", "draw", "total", "cpu")
Turn = Mapping[str, float]
"""What a frame took on average, milliseconds by name, and ``decodes`` and ``error``."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SceneBenchConfig:
    """What to measure."""

    heads: int = 5
    """The most heads; scenes of fewer are measured too."""
    width: int = 1280
    """Columns of the image, pixels."""
    height: int = 720
    """Rows of the image, pixels."""
    rounds: int = 8
    """Turns of each case, of five frames each."""

    def __post_init__(self) -> None:
        check_ranges(self, heads=(1, 16), rounds=(2, 1000), width=(16, 8192), height=(16, 8192))

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows of the image, pixels."""
        return self.width, self.height


@dataclass(slots=True, eq=False)
class _Case:
    """One scene, with the scheduler or with everybody decoded whole in every frame."""

    num_avatars: int
    distance_cm: float
    is_scheduled: bool
    budget_ms: float = math.inf
    heads: list[Head] = field(default_factory=list)
    scheduler: Scheduler = field(default_factory=Scheduler)
    frame: int = 0
    levels: Counter[str] = field(default_factory=Counter)
    shaded_px: float = 0.0
    pixels: int = 0
    triangles: int = 0


def run_scene_bench(config: SceneBenchConfig, avatars: Sequence[Avatar]) -> dict[str, Any]:
    """Measure.

    Args:
        avatars: Dealt to the heads in turn.

    Raises:
        GraphicsError: No GL context.
    """
    with gl_context() as context:
        bench = _Bench(context, config, avatars)
        cases = bench.cases()
        turns = take_turns(cases, bench.turn, rounds=config.rounds, warm_up=1)
        rows = [bench.row(case, found) for case, found in zip(cases, turns, strict=True)]
        return report(config, rows, summary=summarise(rows), gl_renderer=bench.gl_renderer)


class _Bench:
    """The heads, on the GPU twice: as they are treated, and as they should look."""

    def __init__(
        self, context: moderngl.Context, config: SceneBenchConfig, avatars: Sequence[Avatar]
    ) -> None:
        self._context, self._config = context, config
        count = config.heads
        self._avatars = [avatars[index % len(avatars)] for index in range(count)]
        decoders = {id(avatar): OnnxDecoder(avatar) for avatar in avatars}
        self._decoders = [decoders[id(avatar)] for avatar in self._avatars]
        self._encoders = [ExpressionEncoder(avatar) for avatar in self._avatars]
        # Each from elsewhere: five people do not blink together.
        self._faces = [
            make_performance("talk", seed=index, start_s=2.3 * index) for index in range(count)
        ]
        # Smoothed edges cost the same everywhere and would hide errors of silhouettes.
        options = RenderOptions(smooth_edges=False)
        self._renderer = Renderer(context, config.size, options)
        for index, avatar in enumerate(self._avatars):
            for kind in ("head", "truth"):
                self._renderer.add_avatar(f"{kind}-{index}", avatar)
        self.gl_renderer = self._renderer.gl_renderer

    def cases(self) -> list[_Case]:
        """Every scene and one head that fills the screen, without and with the scheduler; the most
        heads with each budget."""
        scenes = [(1, FULL_SCREEN_CM)]
        scenes += [(n, cm) for cm in DISTANCES_CM for n in range(1, self._config.heads + 1)]
        cases = [_Case(n, cm, scheduled) for n, cm in scenes for scheduled in (False, True)]
        limited = [(cm, budget) for cm in DISTANCES_CM for budget in BUDGETS_MS]
        return cases + [_Case(self._config.heads, cm, True, budget) for cm, budget in limited]

    def turn(self, case: _Case, number: int) -> Turn:
        """Draw some frames of a case; those of a negative number warm up."""
        count = TURN_FRAMES if number >= 0 else WARM_UP_FRAMES
        frames = [self._frame(case, has_error=False) for _ in range(count - 1)]
        frames.append(self._frame(case, has_error=number >= 0))
        return {
            name: float(np.mean([frame[name] for frame in frames if name in frame]))
            for name in frames[-1]
        }

    def row(self, case: _Case, turns: Sequence[Turn]) -> dict[str, Any]:
        """What came out."""
        found = {name: np.sort([turn[name] for turn in turns]) for name in turns[0]}
        quarter = len(turns) // 4
        means = {name: values[quarter : len(turns) - quarter] for name, values in found.items()}
        low, middle, high = np.percentile(found["total"], (25, 50, 75))
        return {
            "avatars": case.num_avatars,
            "distance_cm": case.distance_cm,
            "scheduler": case.is_scheduled,
            "budget_ms": None if math.isinf(case.budget_ms) else case.budget_ms,
            **{f"{name}_ms": round(float(means[name].mean()), 3) for name in TIMES},
            "spread": round(float((high - low) / middle), 3),
            "error": round(float(found["error"].mean()), 3),
            "decodes": round(float(found["decodes"].mean()), 2),
            "levels": dict(sorted(case.levels.items())),
            "pixels": case.pixels,
            "triangles": case.triangles,
        }

    def _frame(self, case: _Case, *, has_error: bool) -> dict[str, float]:
        """Treat and draw a frame; what it took, and what is wrong with it if that is asked for."""
        now = case.frame / FPS
        case.frame += 1
        camera = front_camera(self._avatars[0].manifest, case.distance_cm, self._config.size)
        self._place_heads(case, now)
        took: dict[str, float] = defaultdict(float, dict.fromkeys(TIMES, 0.0))
        begin_cpu_s = time.process_time()
        self._treat(case, camera, now, took)
        placements = []
        for head in case.heads:
            placement = Placement(slot=head.slot, world_from_head=head.world_from_head)
            placements.append(head.dressed(placement) if case.is_scheduled else placement)
        self._renderer.forget_frame()
        begin_s = time.perf_counter()
        stats = self._renderer.draw(placements, camera)
        wait_for_gpu(self._context)
        draw_s = time.perf_counter() - begin_s
        took["draw"] = draw_s * 1e3
        took["cpu"] = (time.process_time() - begin_cpu_s) * 1e3
        took["total"] = sum(took[name] for name in ("plan", "decode", "upload", "draw"))
        case.triangles = stats.num_triangles
        if case.is_scheduled:
            case.scheduler.costs.observe_draw(stats.num_triangles, case.shaded_px, draw_s)
        if has_error:
            shown = read_drawing(self._renderer)
            truth = self._draw_truth(case.heads, camera)
            took["error"], case.pixels = drawn_mse(shown, truth), int(truth.covered.sum())
        return took

    def _place_heads(self, case: _Case, now: float) -> None:
        if not case.heads:
            avatars = self._avatars[: case.num_avatars]
            case.heads = [
                Head(slot=f"head-{index}", avatar=avatar) for index, avatar in enumerate(avatars)
            ]
        for index, head in enumerate(case.heads):
            face = self._faces[index].frame_at(now)
            seat = np.eye(4)
            # Nearest first: the middle, then left and right of it in turn.
            seat[0, 3] = SPACING_M * ((index + 1) // 2) * (1 if index % 2 else -1)
            head.world_from_head = head_matrix(seat, face.rotation, face.translation_m)
            head.latent = self._encoders[index].encode(face.arkit)
            head.captured_us = round(now * 1e6)

    def _treat(self, case: _Case, camera: Camera, now: float, took: dict[str, float]) -> None:
        """Decode and upload what this way of treating the scene wants."""
        requests = [(head, _whole(head, camera)) for head in case.heads]
        if case.is_scheduled:
            begin_s = time.perf_counter()
            budget_s = case.budget_ms * 1e-3
            plan = case.scheduler.plan_view(case.heads, [camera], self._config.size, budget_s, now)
            case.shaded_px = plan.shaded_px
            requests = requests_of(case.heads, now)
            took["plan"] = (time.perf_counter() - begin_s) * 1e3
            shown = [head.choice for head in case.heads if head.sight.is_visible]
            case.levels.update(str(choice.level) for choice in shown if choice is not None)
        took["decodes"] = sum(1.0 if each.parts == "both" else 0.5 for _, each in requests)
        for head, request in requests:
            slot = head.slot
            decoder = self._decoders[int(slot.partition("-")[2])]
            decoder.prepare(request.level, request.parts)
            wanted = request.latent, request.view_direction, request.level, request.parts
            decoded_s, maps = timed(decoder.decode, *wanted)
            uploaded_s, _ = timed(
                self._renderer.update_maps, slot, maps.position_map, maps.expression_map
            )
            took["decode"] += decoded_s * 1e3
            took["upload"] += uploaded_s * 1e3
            if case.is_scheduled:
                result = DecodeResult(slot, maps, None, finished_s=decoded_s, parts=request.parts)
                case.scheduler.note_decoded(head, result, uploaded_s)

    def _draw_truth(self, heads: Sequence[Head], camera: Camera) -> Drawing:
        """What should be shown: everybody's newest latent at the full level."""
        placements = []
        for index, head in enumerate(heads):
            request = _whole(head, camera)
            maps = self._decoders[index].decode(request.latent, request.view_direction)
            self._renderer.update_maps(f"truth-{index}", maps.position_map, maps.expression_map)
            placements.append(
                Placement(slot=f"truth-{index}", world_from_head=head.world_from_head)
            )
        self._renderer.draw(placements, camera)
        return read_drawing(self._renderer)


def summarise(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The largest number of heads at each distance, over one head that fills the screen."""
    most = max(row["avatars"] for row in rows)
    full_ms = next(row["total_ms"] for row in rows if row["distance_cm"] == FULL_SCREEN_CM)
    scenes = []
    for distance in sorted({row["distance_cm"] for row in rows} - {FULL_SCREEN_CM}):
        plain, free = (
            row
            for row in rows
            if (row["avatars"], row["distance_cm"], row["budget_ms"]) == (most, distance, None)
        )
        scenes.append(
            {
                "distance_cm": distance,
                "scheduled_over_full_screen": round(free["total_ms"] / full_ms, 3),
                "unscheduled_over_full_screen": round(plain["total_ms"] / full_ms, 3),
                "error": free["error"],
            }
        )
    return {"full_screen_ms": full_ms, "scenes": scenes}


def _whole(head: Head, camera: Camera) -> DecodeRequest:
    """Everything at its best."""
    return DecodeRequest(
        head.latent, view_direction(head.world_from_head, camera.centre_m), head.captured_us
    )
