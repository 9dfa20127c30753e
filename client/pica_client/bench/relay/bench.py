"""`pica bench relay`: rooms full of simulated peers, and what they cost the relay.

Every peer is a real websocket that publishes one stream and receives those of the others in its
room (`peer`); `swarm` drives all of them. The relay is a process of its own, on a core of its own.
What it does not show: real networks, TLS, slow receivers.
"""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pica_client.bench.relay.swarm import FPS, Swarm
from pica_client.errors import check_ranges
from pica_client.local_call.processes import Children
from pica_client.stats import describe_machine, summarise_ms
from pica_client.system import say, terminate_as_interrupt

SETTLE_S: Final = 1.5
"""Between the first frame and the first that counts: queues and windows find their size."""
NO_LIMITS: Final = (
    *("--limits.joins-per-s", "100000", "--limits.joins-burst", "100000"),
    *("--limits.handshakes", "4096"),
)
"""Arguments of a relay whose limits on joins are not what is measured."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RelayBenchConfig:
    """How much to load; the options of `pica bench relay`."""

    rooms: int = 20
    """Number of rooms."""
    peers: int = 5
    """Peers in each room, each a websocket that sends to all others of the room."""
    seconds: float = 10.0
    """Measured time, seconds."""

    def __post_init__(self) -> None:
        check_ranges(self, rooms=(1, 10_000), peers=(2, 64), seconds=(0.5, 600))


def bench_relay(options: RelayBenchConfig) -> dict[str, Any]:
    """Load a relay with rooms of simulated peers; measure forwarding latency and cost.

    Latency is from one peer's send call to another's receive call on this machine.

    Raises:
        ClientError: The relay does not answer, or refuses peers.
    """
    with terminate_as_interrupt(), Children() as children:
        relay, url = children.start_relay(
            *("--max-connections", str(options.rooms * options.peers + 64)),
            *("--room-capacity", str(max(options.peers + 2, 16))),
            *NO_LIMITS,
        )
        return measure(options, url, relay.pid, "relay") | {"machine": describe_machine()}


def measure(config: RelayBenchConfig, url: str, pid: int, name: str) -> dict[str, Any]:
    """Load one server.

    Args:
        pid: The id of its process, which runs here.
        name: What it is called on stderr.

    Raises:
        ClientError: It does not answer, or refuses peers.
    """
    swarm, num_peers = Swarm(), config.rooms * config.peers
    idle_bytes = memory_bytes(pid)
    with _own_cores(pid):
        try:
            swarm.join(url, config.rooms, config.peers)
            say(f"{name}: {num_peers} peers in {config.rooms} rooms")
            swarm.send(SETTLE_S)
            begin_s, own_cpu_s, its_cpu_s = time.monotonic(), time.process_time(), cpu_s(pid)
            swarm.measure(config.seconds)
            own_cpu_s = time.process_time() - own_cpu_s
            its_cpu_s = cpu_s(pid) - its_cpu_s
            cpu_ratio = its_cpu_s / (time.monotonic() - begin_s)
            swarm.drain(swarm.tally.sent * (config.peers - 1))
            held_bytes = memory_bytes(pid)
        finally:
            swarm.close()
    tally = swarm.tally
    delivered_per_s = len(tally.delays_us) / config.seconds
    forward = summarise_ms(delay_us / 1e6 for delay_us in tally.delays_us)
    result = {
        "rooms": config.rooms,
        "peers": config.peers,
        "fps": FPS,
        "seconds": config.seconds,
        "connections": num_peers,
        "delivered_per_s": round(delivered_per_s, 1),
        "sent_per_s": round(tally.sent / config.seconds, 1),
        "forward_ms": forward,
        "missing": tally.sent * (config.peers - 1) - len(tally.delays_us),
        "relay_cpu_s_per_1000": round(cpu_ratio / max(delivered_per_s, 1e-3) * 1000, 5),
        "relay_cpu_ratio": round(cpu_ratio, 3),
        "bytes_per_connection": round(max(held_bytes - idle_bytes, 0) / num_peers),
        "errors": tally.codes.total(),
        "generator_cpu_ratio": round(own_cpu_s / config.seconds, 3),
    }
    say(
        f"{name}: {delivered_per_s:,.0f} frames/s delivered, forwarding p50 {forward['p50']} ms, "
        f"p99 {forward['p99']} ms, missing {result['missing']}, processor "
        f"{result['relay_cpu_s_per_1000']} s per 1,000"
    )
    return result


@contextmanager
def _own_cores(server: int) -> Iterator[None]:
    """Let a server and the load run on one core each while the block runs, where that can
    be had."""
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if len(cores) < 2:
        yield
        return
    os.sched_setaffinity(server, {max(cores)})
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def cpu_s(pid: int) -> float:
    """Processor time that a process has used, user and system; 0 where there is no /proc."""
    stat = Path(f"/proc/{pid}/stat")
    fields = stat.read_text().rpartition(")")[2].split() if stat.exists() else [0] * 13
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_bytes(pid: int) -> int:
    """Resident memory of a process; 0 where there is no /proc."""
    statm = Path(f"/proc/{pid}/statm")
    pages = int(statm.read_text().split()[1]) if statm.exists() else 0
    return pages * os.sysconf("SC_PAGE_SIZE")
