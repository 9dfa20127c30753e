"""What decoding one face costs: every level, the straightforward export, the baseline, the blocks.

The fields of its rows stand in ``docs/benches.md``. What it does not show: drawing (`pica bench
render`), several avatars at once, other providers than the one chosen.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from statistics import median
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from cyclopts import Parameter

from pica_client.bench.harness import Took, gl_context, median_ms, spread, take_turns, timed
from pica_client.bench.head import FRAME_S, front_camera
from pica_client.bench.option_types import Ints, Words, check_names
from pica_client.decode.decoder import BaselineDecoder, OnnxDecoder, OnnxOptions, open_session
from pica_client.decode.onnx_runtime import onnxruntime
from pica_client.decode.request import DecodedMaps, Parts
from pica_client.errors import OptionError, check_ranges
from pica_client.output import say
from pica_client.render.renderer import Renderer
from pica_client.schedule.frame_planner import FramePlanner
from pica_client.schedule.head import Head
from pica_client.schedule.scheduler import Scheduler
from pica_client.schedule.visibility import Sight
from pica_client.sources import open_source
from pica_client.stats import describe_machine, percentile
from pica_core.avatar.decoder_layers import decoder_layers
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.avatar.level_tensors import exit_shapes, is_index, local_name, local_shape
from pica_core.avatar.spec import BLOCKS
from pica_core.graphs.onnx_graph import decoder_graph
from pica_core.reference.baseline import baseline_like
from pica_core.types import FloatArray

EQUAL = 1e-4
"""Share of the largest value by which two exports may differ (float32 through some dozen layers,
summed in another order)."""
NUM_LATENTS = 16
"""Faces decoded in turn, spread over the source (chosen: what a decode costs does not depend on
them)."""
SOURCE = "performance:talk"
SOURCE_S = 30.0
NUM_TALK_FRAMES = 300
DISTANCE_CM = 65.0
IMAGE_SIZE = (720, 720)
FRAME_BUDGET_S = 10.0
"""More than a frame takes, for the level must not change with the machine's mood."""
WARM_UP_ROUNDS = 3
BASELINE_FRAME = "baseline frame"
TALKING = ("talk", "frame", BASELINE_FRAME)
AHEAD = np.array([0, 0, 1], np.float32)

Decode = Callable[[FloatArray], object]
Provider = Annotated[
    OnnxOptions,
    Parameter(
        name="provider",
        converter=lambda _, tokens: OnnxOptions.for_provider(tokens[0].value),
        n_tokens=1,
        accepts_keys=False,
        metavar="NAME",
        show_default=lambda options: options.provider,
    ),
]


@dataclass(frozen=True, kw_only=True, slots=True)
class DecodeBenchConfig:
    """What is measured."""

    rounds: int = 60
    """Decodes of each case."""
    threads: Ints = (1, 2)
    """Threads of ONNX Runtime, separated by commas."""
    blocks: Words = BLOCKS
    """Candidate blocks to measure with random weights, separated by commas; empty for none."""
    head_px: float = 640.0
    """Height of the head on screen, pixels, that errors and the scheduler's level are told for
    (chosen: 65 cm before the viewer's camera of 32 degrees, in a window 720 rows high)."""
    seed: int = 0
    """Seed of random weights and of the order of turns."""
    onnx: Provider = field(default_factory=OnnxOptions)
    """ONNX Runtime execution provider, as NAME or NAME:key=value,key=value."""

    def __post_init__(self) -> None:
        check_ranges(self, rounds=(1, 10_000), head_px=(1, 1e5), seed=(0, 2**32))
        if not self.threads or not all(1 <= threads <= 64 for threads in self.threads):
            raise OptionError(f"threads is {self.threads}; one or more of 1 to 64 are needed")
        check_names("block", self.blocks, BLOCKS)


@dataclass(frozen=True, slots=True)
class Case:
    """One way to decode that is measured."""

    model: str
    level: int | None
    parts: str
    threads: int
    is_plain: bool = False


def run_decode_bench(config: DecodeBenchConfig, avatar: Avatar) -> dict[str, Any]:
    """Measure an avatar's decoders; see the module for rows and summary.

    Raises:
        OptionError: The provider cannot be had.
        GraphicsError: No GL context.
    """
    with gl_context() as context:
        latents = bench_latents(avatar)
        talk = bench_latents(avatar, NUM_TALK_FRAMES, NUM_TALK_FRAMES * FRAME_S)
        models = {"pica": avatar} | {
            f"block {block}": random_decoders(avatar, block, config.seed) for block in config.blocks
        }
        differences = {}
        for name, model in models.items():
            say(f"comparing the exports of {name}")
            for level in model.levels:
                differences[name, level] = export_difference(model, level, latents[:4], config.onnx)
        decodes = dict(_cases(config, models, Renderer(context, IMAGE_SIZE)))

        def decode(case: Case, number: int) -> Took:
            faces = talk if case.model in TALKING else latents
            return timed(decodes[case], faces[number % len(faces)])[0]

        cases = list(decodes)
        samples = take_turns(
            cases, decode, rounds=config.rounds, warm_up=WARM_UP_ROUNDS, seed=config.seed
        )
        took = dict(zip(cases, samples, strict=True))
        rows = [
            _row(case, took, models.get(case.model), differences, latents, config)
            | {"upload_bytes": _upload_bytes(decodes[case])}
            for case in cases
            if not case.is_plain
        ]
        return {
            "avatar": avatar.manifest.name,
            "block": avatar.spec.block,
            "provider": config.onnx.provider,
            "rounds": config.rounds,
            "head_px": config.head_px,
            "machine": describe_machine() | {"onnxruntime": onnxruntime.__version__},
            "rows": rows,
            "summary": _summarise(took, avatar, config),
        }


def bench_latents(
    avatar: Avatar, count: int = NUM_LATENTS, seconds: float = SOURCE_S
) -> list[FloatArray]:
    """Faces of a performance, evenly spaced, float32 ``[8, 8, 4]`` each."""
    source, encoder = open_source(SOURCE), ExpressionEncoder(avatar)
    times_s = np.linspace(0, seconds, count, endpoint=False).tolist()
    return [encoder.encode(source.frame_at(time_s).arkit) for time_s in times_s]


def random_decoders(avatar: Avatar, block: str, seed: int) -> Avatar:
    """An avatar of another block with random weights: decoders and exits alone, to be timed."""
    spec = replace(avatar.spec, block=block)
    shapes: dict[str, tuple[int, ...]] = {}
    for decoder in spec.decoder_channels:
        for layer in decoder_layers(spec, decoder):
            shapes |= layer.tensor_shapes()
    for level in avatar.levels[:-1]:
        texel = avatar.tensors.get(f"level.{level}.geometry.texel", np.zeros(1))
        shapes |= exit_shapes(spec, level, avatar.position_rows(level), texel.shape[-1])
        if local_name(level) in avatar.tensors:
            shapes[local_name(level)] = local_shape(spec, level)
    rng = np.random.default_rng(seed)
    tensors: dict[str, npt.NDArray[Any]] = {
        name: array
        for name, array in avatar.tensors.items()
        if name == "geometry.mean"
        or name.startswith(("linear.", "mesh."))
        or name.endswith(".faces")
    }
    for name, shape in shapes.items():
        if is_index(name):
            tensors[name] = avatar.tensors[name]
            continue
        spread = np.sqrt(2 / np.prod(shape[1:])) if len(shape) == 4 else 0.05
        tensors[name] = rng.standard_normal(shape, np.float32) * np.float32(spread)
    return Avatar(replace(avatar.manifest, spec=spec), tensors)


def export_difference(
    avatar: Avatar, level: int, latents: Sequence[FloatArray], onnx: OnnxOptions
) -> float:
    """How far the fast and the straightforward export of a level differ.

    Returns:
        The largest difference of any value of either map, over the largest value of that map.
    """
    fast = OnnxDecoder(avatar, onnx)
    plain = open_session(decoder_graph(avatar, level=level, plain=True), onnx)
    worst = 0.0
    for latent in latents:
        maps = fast.decode(latent, AHEAD, level)
        wanted = _run_plain(plain, latent)
        for made, reference in zip((maps.position_map, maps.expression_map), wanted, strict=True):
            assert made is not None
            worst = max(worst, float(np.abs(made - reference).max() / np.abs(reference).max()))
    return worst


def _summarise(
    took: dict[Case, list[Took]], avatar: Avatar, config: DecodeBenchConfig
) -> dict[str, Any]:
    """The ratios that the product is measured by, and the level that the scheduler would choose."""

    def ratio(over: Case, under: Case) -> float:
        pairs = zip(took[over], took[under], strict=True)
        return round(median(one.wall_s / other.wall_s for one, other in pairs), 2)

    by_threads: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    for each in took:
        if each.level is None or each.is_plain or each.parts != "both" or each.model in TALKING:
            continue
        models = by_threads.setdefault(str(each.threads), {})
        ratios = models.setdefault(each.model, defaultdict(dict))
        level = str(each.level)
        full = replace(each, level=avatar.spec.map_size)
        ratios["baseline_ratio"][level] = ratio(Case("baseline", None, "all", each.threads), each)
        ratios["plain_ratio"][level] = ratio(replace(each, is_plain=True), each)
        ratios["level_ratio"][level] = ratio(full, each)
    talking: dict[str, dict[str, float]] = defaultdict(dict)
    for name, baseline in (("talk", "baseline"), ("frame", BASELINE_FRAME)):
        for threads in config.threads:
            over = Case(baseline, None, "all", threads)
            under = Case(name, avatar.spec.map_size, "both", threads)
            cpu_s, other_cpu_s = (
                median(each.cpu_s for each in took[case]) for case in (over, under)
            )
            talking[f"{name}_ratio"][str(threads)] = ratio(over, under)
            talking[f"{name}_cpu_ratio"][str(threads)] = round(cpu_s / other_cpu_s, 2)
    return {
        "by_threads": by_threads,
        "level_at_head_px": level_for(avatar, config.head_px),
        **talking,
    }


def level_for(avatar: Avatar, head_px: float) -> int:
    """The level that a scheduler with time enough gives a talking head of this height."""
    head = Head(slot="head", avatar=avatar, sight=Sight(True, head_px=head_px))
    return Scheduler().level(head)


class _Talk:
    """The full level of an avatar, frame after frame."""

    def __init__(self, avatar: Avatar, onnx: OnnxOptions) -> None:
        self.decoder = OnnxDecoder(avatar, onnx)
        self.num_frames = 0

    def __call__(self, latent: FloatArray) -> DecodedMaps:
        self.num_frames += 1
        return self.decoder.decode(latent, AHEAD)


class _Frame(_Talk):
    """What a frame of a talking head costs but for drawing it: plan, decode, upload."""

    def __init__(self, avatar: Avatar, onnx: OnnxOptions, renderer: Renderer, slot: str) -> None:
        super().__init__(avatar, onnx)
        self._renderer, self._slot = renderer, slot
        renderer.add_avatar(slot, avatar)
        self._head = Head(slot=slot, avatar=avatar)
        self._camera = front_camera(avatar.manifest, DISTANCE_CM, IMAGE_SIZE)
        self._planner = FramePlanner(Scheduler())

    def __call__(self, latent: FloatArray) -> DecodedMaps:
        now = self.num_frames * FRAME_S
        self._head.latent = latent
        self._planner.plan([self._head], [self._camera], IMAGE_SIZE, FRAME_BUDGET_S, now)
        self._planner.requests([self._head], now)  # always decoded here, however little has changed
        maps = super().__call__(latent)
        self._renderer.update_maps(self._slot, maps.position_map, maps.expression_map)
        return maps

    @property
    def bytes_uploaded(self) -> int:
        return self._renderer.bytes_uploaded(self._slot)


def _upload_bytes(decode: Decode) -> int | None:
    """Bytes uploaded, of a frame."""
    if not isinstance(decode, _Frame):
        return None
    return round(decode.bytes_uploaded / max(decode.num_frames, 1))


def _baseline_frame(
    decoder: BaselineDecoder, renderer: Renderer, slot: str, latent: FloatArray
) -> None:
    decoded = decoder.decode(latent, AHEAD)
    renderer.update_textured(slot, decoded.vertices_m, decoded.texture)


def _cases(
    config: DecodeBenchConfig, models: dict[str, Avatar], renderer: Renderer
) -> Iterator[tuple[Case, Decode]]:
    baseline, pica = baseline_like(models["pica"], config.seed), models["pica"]
    for threads in config.threads:
        onnx = replace(config.onnx, threads=threads)
        full, slot = pica.spec.map_size, f"baseline {threads}"
        yield Case("talk", full, "both", threads), _Talk(pica, onnx)
        yield (
            Case("frame", full, "both", threads),
            _Frame(pica, onnx, renderer, f"pica {threads}"),
        )
        renderer.add_textured(slot, baseline)
        yield (
            Case(BASELINE_FRAME, None, "all", threads),
            partial(_baseline_frame, BaselineDecoder(baseline, onnx), renderer, slot),
        )
        for name, avatar in models.items():
            decoder = OnnxDecoder(avatar, onnx)
            parts_of: tuple[Parts, ...] = ("both", "expression") if name == "pica" else ("both",)
            for level in avatar.levels:
                for parts in parts_of:
                    decoder.prepare(level, parts)
                    decode = partial(_decode, decoder, level=level, parts=parts)
                    yield Case(name, level, parts, threads), decode
                plain = open_session(decoder_graph(avatar, level=level, plain=True), onnx)
                yield Case(name, level, "both", threads, is_plain=True), partial(_run_plain, plain)
        yield (
            Case("baseline", None, "all", threads),
            partial(_decode, BaselineDecoder(baseline, onnx)),
        )


def _decode(decoder: Any, latent: FloatArray, **which: Any) -> object:
    return decoder.decode(latent, AHEAD, **which)


def _run_plain(session: Any, latent: FloatArray) -> Any:
    feeds = {"latent": latent[None], "view_direction": AHEAD[None]}
    return session.run(["position_map", "expression_map"], feeds)


def _row(
    case: Case,
    took: dict[Case, list[Took]],
    avatar: Avatar | None,
    differences: dict[tuple[str, int], float],
    latents: Sequence[FloatArray],
    config: DecodeBenchConfig,
) -> dict[str, Any]:
    own = [each.wall_s for each in took[case]]
    plain = took.get(replace(case, is_plain=True))
    level = case.level
    row = {
        "model": case.model,
        "level": level,
        "parts": case.parts,
        "threads": case.threads,
        "ms": median_ms(own),
        "p95": round(percentile(sorted(own), 95) * 1e3, 3),
        "spread": spread(own),
        **dict.fromkeys(("mse", "vertex_mm", "plain_ms", "is_equal", "difference")),
    }
    if plain is not None and level is not None:
        difference = differences[case.model, level]
        row["plain_ms"] = median_ms([each.wall_s for each in plain])
        row["is_equal"] = difference <= EQUAL
        row["difference"] = float(f"{difference:.2g}")
    if avatar is not None and level is not None and case.model == "pica":
        if (errors := avatar.level_errors) is not None:
            row["mse"] = round(errors.at(level, config.head_px), 3)
        row["vertex_mm"] = round(vertex_error_mm(avatar, level, latents), 4)
    return row


def vertex_error_mm(avatar: Avatar, level: int, latents: Sequence[FloatArray]) -> float:
    """Mean distance of a level's vertices from those of the full level, millimetres."""
    if level == avatar.spec.map_size:
        return 0.0
    decoder = OnnxDecoder(avatar)
    used = np.unique(avatar.level_faces(level))
    distances_m = []
    for latent in latents:
        sheet, full = (decoder.decode(latent, AHEAD, size).position_map for size in (level, None))
        assert sheet is not None
        assert full is not None
        whole = avatar.vertices_of(full, avatar.spec.map_size)
        moved = avatar.vertices_of(sheet, level) - whole[used]
        distances_m.append(float(np.linalg.norm(moved, axis=1).mean()))
    return 1e3 * float(np.mean(distances_m))
