"""`pica bench playout`."""

from typing import Any

from pica_client.bench.playout import BenchPlayoutConfig, run_bench_playout
from pica_client.cli.bench.avatars import AvatarBenchOptions


def bench_playout(options: AvatarBenchOptions[BenchPlayoutConfig]) -> dict[str, Any]:
    """Measure what the playout makes of troubled networks: rendered error, delay, recovery.

    Runs on a virtual clock and needs no network. Compares the receiver's playout with a fixed
    buffer of 100 ms and with none.
    """
    return run_bench_playout(options.config, options.load())
