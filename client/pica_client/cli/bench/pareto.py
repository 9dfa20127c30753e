"""`pica bench pareto`: error against milliseconds of one face."""

from typing import Any

from pica_client.bench.pareto import ParetoBenchConfig, run_pareto_bench
from pica_client.cli.bench.avatars import AvatarBenchOptions
from pica_client.output import say


def bench_pareto(options: AvatarBenchOptions[ParetoBenchConfig]) -> dict[str, Any]:
    """Measure error against milliseconds for every level, mesh, precision and block.

    Set LP_NUM_THREADS to say how many threads software GL takes.
    """
    result = run_pareto_bench(options.config, options.load())
    for row in result["rows"]:
        if row["mse"] is not None:
            say(
                f"{row['distance_cm']:5g} cm  level {row['level']:3d} mesh {row['mesh']:3d} "
                f"{row['precision']}  {row['total_ms']:7.2f} ms  MSE {row['mse']:8.3f}  "
                f"change {row['change_mse']:7.3f} {'best' if row['is_best'] else ''}"
            )
    return result
