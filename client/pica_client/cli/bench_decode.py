"""`pica bench decode`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pica_client.cli.bench import load_bench_avatar
from pica_client.errors import OptionError
from pica_client.output import say
from pica_core.avatar.spec import BLOCKS


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchDecodeOptions:
    """Options of ``pica bench decode``."""

    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; the first shipped one by default."""
    rounds: int = 60
    """Decodes of each contender."""
    threads: str = "1,2"
    """Threads of ONNX Runtime, separated by commas."""
    blocks: str = ",".join(BLOCKS)
    """Candidate blocks to measure with random weights, separated by commas; empty for none."""
    head_px: float = 640.0
    """Height of the head on screen, pixels, that errors and the scheduler's level are told for."""
    provider: str = "CPUExecutionProvider"
    """ONNX Runtime execution provider, as NAME or NAME:key=value,key=value."""
    seed: int = 0
    """Of random weights and of the order of turns."""


def bench_decode(options: BenchDecodeOptions) -> dict[str, Any]:
    """Measure what decoding one face costs: levels, plain export, baseline, candidate blocks."""
    from pica_client.bench.decode import DecodeBenchConfig, run_decode_bench
    from pica_client.decode.decoder import OnnxOptions

    config = DecodeBenchConfig(
        rounds=options.rounds,
        threads=_threads(options.threads),
        blocks=tuple(word for word in options.blocks.split(",") if word),
        head_px=options.head_px,
        seed=options.seed,
        onnx=OnnxOptions.for_provider(options.provider),
    )
    result = run_decode_bench(config, load_bench_avatar(options.avatar), say)
    for row in result["rows"]:
        say(_line(row))
    for threads, models in result["summary"]["by_threads"].items():
        for model, ratios in models.items():
            for level, ratio in ratios["baseline_ratio"].items():
                say(
                    f"{threads} threads, {model} {level}: baseline over it {ratio:.1f}, "
                    f"plain over fast {ratios['plain_ratio'][level]:.2f}, "
                    f"full over it {ratios['level_ratio'][level]:.2f}"
                )
    level = result["summary"]["level_at_head_px"]
    say(f"the scheduler decodes a head of {result['head_px']:g} px at level {level}")
    return result


def _line(row: dict[str, Any]) -> str:
    line = (
        f"{row['model']:9} {row['level'] or '':>4} {row['parts']:10} {row['threads']} threads  "
        f"{row['ms']:8.3f} ms  p95 {row['p95']:8.3f}  spread {row['spread']:.2f}"
    )
    if row["plain_ms"] is not None:
        equal = "equal" if row["is_equal"] else "NOT EQUAL"
        line += f"  plain {row['plain_ms']:8.3f} ms, {equal} ({row['difference']:g})"
    if row["vertex_mm"] is not None:
        line += f"  {row['vertex_mm']:.3f} mm"
    return line if row["mse"] is None else line + f"  MSE {row['mse']:.2f}"


def _threads(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(word) for word in text.split(","))
    except ValueError as error:
        raise OptionError(f"threads is {text!r}; write numbers with commas") from error
