"""`pica bench decode`."""

from typing import Any

from pica_client.bench.decode import DecodeBenchConfig, run_decode_bench
from pica_client.cli.bench.avatars import AvatarBenchOptions
from pica_client.output import say


def bench_decode(options: AvatarBenchOptions[DecodeBenchConfig]) -> dict[str, Any]:
    """Measure what decoding one face costs: levels, plain export, baseline, candidate blocks."""
    result = run_decode_bench(options.config, options.load())
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
