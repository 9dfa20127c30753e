"""`pica bench relay`. Needs no numpy: it may run where only a relay does."""

from typing import Any

from pica_client.bench.relay.bench import RelayBenchConfig, run_relay_bench
from pica_client.system import terminate_as_interrupt


def bench_relay(options: RelayBenchConfig) -> dict[str, Any]:
    """Load a relay with rooms of simulated peers; measure forwarding latency and cost.

    Latency is from one peer's send call to another's receive call on this machine.
    """
    with terminate_as_interrupt():
        return run_relay_bench(options)
