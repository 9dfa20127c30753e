"""`pica bench relay`. Needs no numpy: it may run where only a relay does."""

from typing import Any

from pica_client.bench.relay.bench import RelayBenchConfig, run_relay_bench
from pica_client.output import say
from pica_client.signals import terminate_as_interrupt


def bench_relay(options: RelayBenchConfig) -> dict[str, Any]:
    """Load a relay with rooms of simulated peers; measure forwarding latency, cost and capacity.

    Latency is from one peer's send call to another's receive call on this machine.
    """
    with terminate_as_interrupt():
        result = run_relay_bench(options)
    if capacity := result.get("capacity"):
        most = "" if capacity["is_limit"] else " or more"
        say(
            f"capacity: {capacity['rooms']} rooms of {result['peers']}{most} with p99 within "
            f"{capacity['bar_ms']:g} ms"
        )
    return result
