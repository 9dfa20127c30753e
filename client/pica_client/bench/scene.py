"""What a scene of several talking heads costs with and without the scheduler, and what error it
leaves.

The fields of its rows stand in ``docs/results.md``. What it does not show: networks and playout
(`pica bench call`), windows, several threads.
"""

import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import moderngl
import numpy as np
import numpy.typing as npt

from pica_client.bench.harness import Floats, Ints, timed
from pica_client.bench.head import FIELD_OF_VIEW, check_distances, front_camera, gl_context
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.request import DecodeRequest, DecodeResult
from pica_client.errors import OptionError, check_ranges
from pica_client.render.drawing import Drawing, drawn_mse, read_drawing
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, head_matrix, view_direction
from pica_client.schedule.frame_planner import FramePlanner
from pica_client.schedule.head import Choice, Head
from pica_client.schedule.scheduler import Scheduler
from pica_client.sources.performances import make_performance
from pica_client.stats import describe_machine
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
"""Frames of a case before the next one has its turn."""
FULL_SCREEN_CM = 18.0
"""Where one head fills the screen; the paper's nearest distance."""
ERROR_EVERY = 5
"""Frames between two whose error is measured."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SceneBenchConfig:
    """What to measure."""

    avatars: Ints = (1, 2, 3, 4, 5)
    """How many heads, separated by commas."""
    distances_cm: Floats = (65.0, 90.0, 120.0)
    """Distances of the camera from the front of the middle head, separated by commas."""
    width: int = 1280
    """Columns of the image, pixels."""
    height: int = 720
    """Rows of the image, pixels."""
    rounds: int = 8
    """Turns of each case, of five frames each."""
    performance: str = "talk"
    """What everybody does: talk, listen or range-of-motion."""
    budget_shares: Floats = (0.75, 0.5)
    """Budgets of the largest scenes, as shares of what they cost unconstrained, with commas."""

    def __post_init__(self) -> None:
        if not self.avatars or not all(1 <= count <= 16 for count in self.avatars):
            raise OptionError(f"avatars are {self.avatars}; 1 to 16 are allowed")
        check_distances(self.distances_cm)
        check_ranges(self, rounds=(2, 1000), width=(16, 8192), height=(16, 8192))
        if not all(0 < share <= 1 for share in self.budget_shares):
            raise OptionError(f"budget_shares are {self.budget_shares}; above 0 to 1 is allowed")

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows of the image, pixels."""
        return self.width, self.height


@dataclass(slots=True)
class _Frame:
    """What one frame took, seconds."""

    plan_s: float = 0.0
    decode_s: float = 0.0
    upload_s: float = 0.0
    draw_s: float = 0.0
    cpu_s: float = 0.0
    decodes: float = 0.0
    floor_s: float = 0.0
    error: float | None = None

    @property
    def total_s(self) -> float:  # read by name, see `_turn_means_ms`
        return self.plan_s + self.decode_s + self.upload_s + self.draw_s


@dataclass(slots=True, eq=False)
class _Case:
    """One scene, treated in one way."""

    num_avatars: int
    distance_cm: float
    is_scheduled: bool
    budget_s: float = math.inf
    heads: list[Head] = field(default_factory=list)
    planner: FramePlanner = field(default_factory=lambda: FramePlanner(Scheduler()))
    frame: int = 0
    frames: list[_Frame] = field(default_factory=list)
    levels: Counter[str] = field(default_factory=Counter)
    meshes: Counter[str] = field(default_factory=Counter)
    num_limited: int = 0
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
        cases = bench.free_cases()
        bench.measure(cases)
        limited = bench.limited_cases(cases)
        bench.measure(limited)
        rows = [bench.row(case) for case in [*cases, *limited]]
        return {
            "avatars": [avatar.manifest.identity for avatar in avatars],
            "gl_renderer": bench.gl_renderer,
            "size": list(config.size),
            "field_of_view_degrees": round(math.degrees(FIELD_OF_VIEW), 1),
            "spacing_cm": SPACING_M * 100,
            "rounds": config.rounds,
            "rows": rows,
            "summary": summarise(rows),
            "machine": describe_machine(),
        }


class _Bench:
    """The heads, on the GPU twice: as they are treated, and as they should look."""

    def __init__(
        self, context: moderngl.Context, config: SceneBenchConfig, avatars: Sequence[Avatar]
    ) -> None:
        self._context, self._config = context, config
        count = max(config.avatars)
        self._avatars = [avatars[index % len(avatars)] for index in range(count)]
        decoders = {id(avatar): OnnxDecoder(avatar) for avatar in avatars}
        self._decoders = [decoders[id(avatar)] for avatar in self._avatars]
        self._encoders = [ExpressionEncoder(avatar) for avatar in self._avatars]
        # Each from elsewhere: five people do not blink together.
        self._faces = [
            make_performance(config.performance, seed=index, start_s=2.3 * index)
            for index in range(count)
        ]
        # Smoothed edges cost the same everywhere and would hide errors of silhouettes.
        options = RenderOptions(smooth_edges=False)
        self._renderer = Renderer(context, config.size, options)
        for index, avatar in enumerate(self._avatars):
            for kind in ("head", "truth"):
                self._renderer.add_avatar(f"{kind}-{index}", avatar)
        self.gl_renderer = self._renderer.gl_renderer

    def free_cases(self) -> list[_Case]:
        """Every scene and one head that fills the screen, with and without the scheduler."""
        cases = [_Case(1, FULL_SCREEN_CM, scheduled) for scheduled in (False, True)]
        for distance in self._config.distances_cm:
            for count in self._config.avatars:
                cases += [_Case(count, distance, scheduled) for scheduled in (False, True)]
        return cases

    def limited_cases(self, measured: Sequence[_Case]) -> list[_Case]:
        """The largest scenes with less than they cost, however much that is here."""
        most = max(self._config.avatars)
        return [
            _Case(
                most,
                case.distance_cm,
                True,
                budget_s=share * _mean_ms(case.frames, "total") / 1e3,
            )
            for case in measured
            if case.is_scheduled and case.num_avatars == most and case.distance_cm != FULL_SCREEN_CM
            for share in self._config.budget_shares
        ]

    def measure(self, cases: Sequence[_Case]) -> None:
        """Run all cases in turns."""
        for turn in range(self._config.rounds + 1):
            for case in cases:
                for _ in range(TURN_FRAMES if turn else WARM_UP_FRAMES):
                    frame = self._frame(case, is_measured=turn > 0)
                    if turn:
                        case.frames.append(frame)

    def row(self, case: _Case) -> dict[str, Any]:
        """What came out."""
        frames = case.frames
        errors = [frame.error for frame in frames if frame.error is not None]
        totals = _turn_means_ms(frames, "total")
        low, middle, high = np.percentile(totals, (25, 50, 75))
        num_seen = sum(case.levels.values())
        return {
            "avatars": case.num_avatars,
            "distance_cm": case.distance_cm,
            "scheduler": case.is_scheduled,
            "budget_ms": None if math.isinf(case.budget_s) else round(case.budget_s * 1e3, 2),
            **{
                f"{name}_ms": round(_mean_ms(frames, name), 3)
                for name in ("floor", "decode", "upload", "draw", "plan", "total", "cpu")
            },
            "spread": round(float((high - low) / middle), 3),
            "error": round(float(np.mean(errors)), 3) if errors else None,
            "decodes": round(sum(frame.decodes for frame in frames) / len(frames), 2),
            "limited": round(case.num_limited / num_seen, 3) if num_seen else 0.0,
            "levels": dict(sorted(case.levels.items())),
            "meshes": dict(sorted(case.meshes.items())),
            "pixels": case.pixels,
            "triangles": case.triangles,
            "frames": len(frames),
        }

    def _frame(self, case: _Case, *, is_measured: bool) -> _Frame:
        now = case.frame / FPS
        camera = front_camera(self._avatars[0].manifest, case.distance_cm, self._config.size)
        self._place_heads(case, now)
        frame = _Frame()
        begin_cpu_s = time.process_time()
        choices = self._treat(case, camera, now, frame)
        placements = []
        for head in case.heads:
            placement = Placement(slot=head.slot, world_from_head=head.world_from_head)
            placements.append(head.dressed(placement, now) if case.is_scheduled else placement)
        self._renderer.forget_frame()
        begin_s = time.perf_counter()
        stats = self._renderer.draw(placements, camera)
        wait_for_gpu(self._context)
        frame.draw_s = time.perf_counter() - begin_s
        frame.cpu_s = time.process_time() - begin_cpu_s
        costs = case.planner.scheduler.costs
        shaded_px = sum(head.sight.visible_px for head in case.heads)
        if case.is_scheduled:
            costs.observe_draw(stats.num_triangles, shaded_px, frame.draw_s)
        case.triangles = stats.num_triangles
        if is_measured:
            for choice in choices.values():
                case.levels[str(choice.level)] += 1
                case.meshes[str(choice.mesh_level)] += 1
                case.num_limited += choice.is_limited
        if is_measured and case.frame % ERROR_EVERY == 0:
            shown = read_drawing(self._renderer)
            truth = self._draw_truth(case.heads, camera)
            frame.error, case.pixels = drawn_mse(shown, truth), int(truth.covered.sum())
        case.frame += 1
        return frame

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
            step = (index + 1) // 2 * (1 if index % 2 else -1)
            seat[0, 3] = SPACING_M * step
            head.world_from_head = head_matrix(seat, face.rotation, face.translation_m)
            head.latent = self._encoders[index].encode(face.arkit)
            head.captured_us = round(now * 1e6)

    def _treat(self, case: _Case, camera: Camera, now: float, frame: _Frame) -> dict[str, Choice]:
        """Decode and upload what this way of treating the scene wants; what it chose for those on
        the screen."""
        choices: dict[str, Choice] = {}
        requests: list[tuple[Head, DecodeRequest]] = []
        if case.is_scheduled:
            begin_s = time.perf_counter()
            plan = case.planner.plan(case.heads, [camera], self._config.size, case.budget_s, now)
            requests = case.planner.requests(case.heads, now)
            frame.plan_s = time.perf_counter() - begin_s
            frame.floor_s = plan.floor_s
            choices = {slot: choice for slot, choice in plan.choices.items() if choice.cost_s > 0}
        else:
            requests = [(head, _whole(head, camera)) for head in case.heads]
        for head, request in requests:
            slot = head.slot
            decoder = self._decoders[int(slot.partition("-")[2])]
            decoder.prepare(request.level, request.parts)
            wanted = request.latent, request.view_direction, request.level, request.parts
            decoded, maps = timed(decoder.decode, *wanted)
            shown = maps.position_map, maps.expression_map
            uploaded, _ = timed(self._renderer.update_maps, slot, *shown)
            frame.decodes += 1.0 if request.parts == "both" else 0.5
            frame.decode_s += decoded.wall_s
            frame.upload_s += uploaded.wall_s
            if case.is_scheduled:
                took_s, level, parts = decoded.wall_s, maps.level, request.parts
                result = DecodeResult(slot, maps, None, finished_s=took_s, level=level, parts=parts)
                case.planner.note_decoded(head, result, uploaded.wall_s, now)
        return choices

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
    """The ratios that the rows are measured for; ``docs/results.md`` says which."""
    most = max(row["avatars"] for row in rows)
    full_ms = next(row["total_ms"] for row in rows if row["distance_cm"] == FULL_SCREEN_CM)
    scenes, budgets = [], []
    for distance in sorted({row["distance_cm"] for row in rows} - {FULL_SCREEN_CM}):
        here = [row for row in rows if (row["avatars"], row["distance_cm"]) == (most, distance)]
        plain, free, *limited = here
        scenes.append(
            {
                "distance_cm": distance,
                "scheduled_over_full_screen": round(free["total_ms"] / full_ms, 3),
                "unscheduled_over_full_screen": round(plain["total_ms"] / full_ms, 3),
                "error": free["error"],
            }
        )
        budgets += [
            {
                "distance_cm": distance,
                "budget_over_free": round(row["budget_ms"] / free["total_ms"], 3),
                "floor_over_free": round(row["floor_ms"] / free["total_ms"], 3),
                "spent_over_free": round(row["total_ms"] / free["total_ms"], 3),
                "error": row["error"],
            }
            for row in limited
        ]
    return {"full_screen_ms": full_ms, "scenes": scenes, "budgets": budgets}


def _whole(head: Head, camera: Camera) -> DecodeRequest:
    """Everything at its best."""
    return DecodeRequest(
        head.latent, view_direction(head.world_from_head, camera.centre_m), head.captured_us
    )


def _turn_means_ms(frames: Sequence[_Frame], name: str) -> npt.NDArray[np.float64]:
    """What a part of a frame took on average, turn by turn."""
    values = np.array([getattr(frame, f"{name}_s") for frame in frames])
    means: npt.NDArray[np.float64] = values.reshape(-1, TURN_FRAMES).mean(axis=1) * 1e3
    return means


def _mean_ms(frames: Sequence[_Frame], name: str) -> float:
    """Of the turns' means, the mean of the middle half: neither moved by a few stalls nor blind to
    what is done now and then."""
    values = _turn_means_ms(frames, name)
    quarter = len(values) // 4
    return float(np.sort(values)[quarter : len(values) - quarter].mean())
