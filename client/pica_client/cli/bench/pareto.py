"""`pica bench pareto`: error against milliseconds of one face."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from tyro.conf import OmitArgPrefixes

from pica_client.bench.pareto import ParetoBenchConfig, run_pareto_bench
from pica_client.cli.bench.avatars import load_bench_avatar
from pica_client.output import say


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchParetoOptions:
    """Options of ``pica bench pareto``."""

    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; the first shipped one by default."""
    config: OmitArgPrefixes[ParetoBenchConfig] = field(default_factory=ParetoBenchConfig)


def bench_pareto(options: BenchParetoOptions) -> dict[str, Any]:
    """Measure error against milliseconds for every level, mesh, precision and block.

    Set LP_NUM_THREADS to say how many threads software GL takes.
    """
    result = run_pareto_bench(options.config, load_bench_avatar(options.avatar))
    for row in result["rows"]:
        if row["mse"] is not None:
            say(
                f"{row['distance_cm']:5g} cm  level {row['level']:3d} mesh {row['mesh']:3d} "
                f"{row['precision']}  {row['total_ms']:7.2f} ms  MSE {row['mse']:8.3f}  "
                f"change {row['change_mse']:7.3f} {'best' if row['is_best'] else ''}"
            )
    return result
