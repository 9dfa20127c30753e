"""`pica bench relay`. Needs no numpy: it may run where only a relay does."""

import sys
from dataclasses import dataclass
from typing import Any

from pica_client.signals import terminate_as_interrupt


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchRelayOptions:
    """Options of `pica bench relay`."""

    rooms: int = 20
    """Number of rooms."""
    peers: int = 5
    """Peers in each room, each a websocket that sends to all others of the room."""
    fps: float = 30.0
    """Frames a second of each peer."""
    seconds: float = 10.0
    """Measured time, seconds."""
    url: str | None = None
    """Address of a relay that runs already, ws:// or wss://; by default one is started, pinned to
    one core."""
    processes: int = 1
    """Processes of the load generator."""
    joins_per_s: float | None = None
    """How fast peers come in; by default 40 a second, which a relay's limits allow, and 400 for the
    relay that is started."""
    voices: bool = False
    """Let the peers of each room speak in turn as well."""
    capacity: bool = False
    """Look for the most rooms that stay within the bar."""
    bar: float = 10.0
    """The bar: longest 99th percentile of the forwarding latency, milliseconds."""
    max_rooms: int = 400
    """Where looking for capacity ends."""
    compare: str = ""
    """Give the same load to others as well: naive (read and broadcast, same library), naive-uvloop,
    echo (what the load generator can do at most); separated by commas."""
    ablate: str = ""
    """Give the same load to the relay without one part of its fast path, for each of: short-read,
    direct-write, flow, ride; all of them: all."""
    hostile: str = ""
    """Measure the rooms beside somebody who behaves badly: all, or some of stopped-reader,
    slow-reader, flood, slow-loris, half-open, large-messages, bombs, connects."""
    soak: float = 0.0
    """Keep the load up for so many minutes, tell memory and latency of each, then stop the relay
    and see whether a control message is lost."""
    relay_arguments: str = ""
    """Further arguments of the relay that is started: --relay-arguments="--port 8765"."""
    seed: int = 0
    """Seed of phases and payload sizes."""


def bench_relay(options: BenchRelayOptions) -> dict[str, Any]:
    """Load a relay with rooms of simulated peers; measure forwarding latency, cost and capacity.

    Latency is from one peer's send call to another's receive call on this machine.
    """
    from pica_client.bench.relay.bench import ABLATIONS, RelayBenchConfig, run_relay_bench
    from pica_client.bench.relay.hostile import HostileConfig, parse_kinds, run_hostile_bench
    from pica_client.bench.relay.soak import SoakConfig, run_soak

    config = RelayBenchConfig(
        url=options.url,
        rooms=options.rooms,
        peers=options.peers,
        fps=options.fps,
        seconds=options.seconds,
        processes=options.processes,
        joins_per_s=options.joins_per_s,
        voices=options.voices,
        capacity=options.capacity,
        bar_ms=options.bar,
        max_rooms=max(options.max_rooms, options.rooms),
        compare=tuple(name for name in options.compare.split(",") if name),
        ablate=tuple(ABLATIONS)
        if options.ablate == "all"
        else tuple(name for name in options.ablate.split(",") if name),
        relay_arguments=tuple(options.relay_arguments.split()),
        seed=options.seed,
    )
    with terminate_as_interrupt():
        if options.hostile:
            kinds = tuple(parse_kinds(options.hostile))
            return run_hostile_bench(HostileConfig(load=config, kinds=kinds))
        if options.soak:
            return run_soak(SoakConfig(load=config, minutes=options.soak))
        result = run_relay_bench(config)
    if capacity := result.get("capacity"):
        most = "" if capacity["is_limit"] else " or more"
        print(
            f"capacity: {capacity['rooms']} rooms of {result['peers']}{most} with p99 within "
            f"{capacity['bar_ms']:g} ms",
            file=sys.stderr,
        )
    return result
