"""`pica bench relay`: rooms full of simulated peers, and what they cost the relay.

Every peer is a real websocket that publishes one stream and receives those of the others in its
room (`peer`); `swarm` drives all of them. Without an address the bench starts a relay of its own on
a core of its own. What it does not show: real networks, TLS (unless --url says wss), slow
receivers.
"""

import os
import time
import urllib.error
import urllib.request
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any, Final

from pica_client.bench.harness import Arguments
from pica_client.bench.relay.peer import STEP_US
from pica_client.bench.relay.swarm import Swarm
from pica_client.errors import check_ranges
from pica_client.local_call.processes import START_TIMEOUT_S, Children
from pica_client.output import say
from pica_client.stats import describe_machine
from pica_client.transport.config import check_address

SETTLE_S: Final = 1.5
"""Between the first frame and the first that counts: queues and windows find their size."""
OWN_JOINS_PER_S: Final = 400.0
FOREIGN_JOINS_PER_S: Final = 40.0
"""Of a relay that runs already; its limits allow so many."""
NO_LIMITS: Final = (
    *("--limits.joins-per-s", "100000", "--limits.joins-burst", "100000"),
    *("--limits.handshakes", "4096"),
)
"""Arguments of a relay whose limits on joins are not what is measured."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RelayBenchConfig:
    """What to load, and how; the options of `pica bench relay`."""

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
    relay_arguments: Arguments = ()
    """Further arguments of the relay that is started: --relay-arguments="--port 8765"."""
    seed: int = 0
    """Seed of phases and payload sizes."""

    def __post_init__(self) -> None:
        check_ranges(self, rooms=(1, 10_000), peers=(2, 64), fps=(1, 240), seconds=(0.5, 7200))
        if self.url is not None:
            check_address(self.url)


@dataclass(frozen=True, kw_only=True, slots=True)
class Target:
    """A server under load."""

    url: str
    pid: int | None = None
    """The id of its process, if it runs here and is ours."""
    has_metrics: bool = False

    def read(self) -> "Reading":
        """Return what it counts and costs at this moment."""
        metrics = relay_metrics(self.url) if self.has_metrics else {}
        return Reading(metrics, None if self.pid is None else cpu_s(self.pid), time.monotonic())


@dataclass(frozen=True, slots=True)
class Reading:
    """What a server has counted and used until a moment."""

    metrics: Mapping[str, float]
    cpu_s: float | None
    at_s: float


def run_relay_bench(config: RelayBenchConfig) -> dict[str, Any]:
    """Measure a relay.

    Raises:
        ClientError: The relay does not answer, or refuses peers.
    """
    with Children() as children, relay_target(config, children) as target:
        return measure(config, target, "relay") | {"machine": describe_machine()}


@contextmanager
def relay_target(config: RelayBenchConfig, children: Children) -> Iterator[Target]:
    """The relay under load: the one at the address, or one of our own on its own core."""
    if config.url is not None:
        yield Target(url=config.url, has_metrics=bool(relay_metrics(config.url)))
        return
    relay, url = children.start_relay(
        *("--max-connections", str(config.rooms * config.peers + 64)),
        *("--room-capacity", str(max(config.peers + 2, 16))),
        *NO_LIMITS,
        *config.relay_arguments,
    )
    try:
        yield Target(url=url, pid=relay.pid, has_metrics=True)
    finally:
        relay.let_go()
        relay.wait(time.monotonic() + START_TIMEOUT_S)


def measure(config: RelayBenchConfig, target: Target, name: str) -> dict[str, Any]:
    """Load one server as the configuration says; `name` is what it is called on stderr.

    Raises:
        ClientError: It does not answer, or refuses peers.
    """
    swarm, num_peers = Swarm(fps=config.fps, seed=config.seed), config.rooms * config.peers
    rooms = [f"load-{config.seed}-{index}" for index in range(config.rooms)]
    idle_bytes = None if target.pid is None else memory_bytes(target.pid)
    with _own_cores(target.pid):
        try:
            swarm.join(
                target.url,
                rooms,
                config.peers,
                FOREIGN_JOINS_PER_S if target.pid is None else OWN_JOINS_PER_S,
            )
            say(f"{name}: {num_peers} peers in {config.rooms} rooms")
            swarm.send(SETTLE_S)
            before, own_cpu_s = target.read(), time.process_time()
            swarm.measure(config.seconds)
            own_cpu_s = time.process_time() - own_cpu_s
            after = target.read()
            swarm.drain(swarm.tally.sent * (config.peers - 1))
            held_bytes = None if target.pid is None else memory_bytes(target.pid)
        finally:
            swarm.close()
    result = figures(config, swarm, before, after)
    if idle_bytes is not None and held_bytes is not None:
        result["bytes_per_connection"] = round(max(held_bytes - idle_bytes, 0) / num_peers)
    result["generator_cpu_ratio"] = round(own_cpu_s / config.seconds, 3)
    forward = result["forward_ms"]
    say(
        f"{name}: {result['delivered_per_s']:,.0f} frames/s delivered, forwarding p50 "
        f"{forward['p50']} ms, p99 {forward['p99']} ms, missing {result['missing']}, processor "
        f"{result['relay_cpu_s_per_1000']} s per 1,000"
    )
    return result


def figures(
    config: RelayBenchConfig, swarm: Swarm, before: Reading, after: Reading
) -> dict[str, Any]:
    """Return what a measurement between two readings has found."""
    tally = swarm.tally
    metrics = {name: value - before.metrics.get(name, 0.0) for name, value in after.metrics.items()}
    missing = tally.sent * (config.peers - 1) - tally.received
    delivered_per_s = tally.received / config.seconds
    cpu_ratio = None
    if before.cpu_s is not None and after.cpu_s is not None:
        cpu_ratio = (after.cpu_s - before.cpu_s) / (after.at_s - before.at_s)
    messages = summed(metrics, "pica_messages_out_total")
    frames = summed(metrics, "pica_frames_out_total")
    return {
        "rooms": config.rooms,
        "peers": config.peers,
        "fps": config.fps,
        "seconds": config.seconds,
        "connections": config.rooms * config.peers,
        "delivered_per_s": round(delivered_per_s, 1),
        "sent_per_s": round(tally.sent / config.seconds, 1),
        "forward_ms": percentiles(tally.latency),
        "dropped": round(summed(metrics, "pica_frames_dropped_total")) if metrics else missing,
        "late": round(metrics.get('pica_frames_dropped_total{reason="late"}', 0.0)),
        "missing": missing,
        "blocked": tally.blocked,
        "relay_cpu_s_per_1000": None
        if cpu_ratio is None or not delivered_per_s
        else round(cpu_ratio / delivered_per_s * 1000, 5),
        "relay_cpu_ratio": None if cpu_ratio is None else round(cpu_ratio, 3),
        "bytes_per_connection": None,
        "frames_per_message": round(frames / messages, 2) if messages else None,
        "errors": tally.codes.total(),
        "close_codes": {str(code): count for code, count in tally.codes.items()},
        "generator_turn_ms": percentiles(swarm.turns),
        "overload": round(after.metrics.get("pica_overload", 0.0)),
    }


def percentiles(steps: Mapping[int, int]) -> dict[str, float | None]:
    """Percentiles of a histogram of steps of `STEP_US`, upper edges, in milliseconds."""
    ordered = sorted(steps)
    seen = list(accumulate(steps[step] for step in ordered))
    found: dict[str, float | None] = {}
    for percent in (50, 95, 99):
        place = bisect_left(seen, seen[-1] * percent / 100) if seen else None
        ms = None if place is None else round((ordered[place] + 1) * STEP_US / 1e3, 3)
        found[f"p{percent}"] = ms
    return found


@contextmanager
def _own_cores(server: int | None) -> Iterator[None]:
    """Let a server of ours and the load run on one core each while the block runs, where that can
    be had."""
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if server is None or len(cores) < 2:
        yield
        return
    os.sched_setaffinity(server, {max(cores)})
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def cpu_s(pid: int) -> float | None:
    """Processor time that a process has used, of user and system; None where that is not told."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_bytes(pid: int) -> int | None:
    """Resident memory of a process; None where that is not told."""
    try:
        pages = Path(f"/proc/{pid}/statm").read_text().split()[1]
    except OSError:
        return None
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def relay_metrics(url: str) -> dict[str, float]:
    """What the relay itself counts, by Prometheus name and labels; empty if it does not tell us."""
    page = url.replace("ws", "http", 1).rstrip("/") + "/metrics"
    try:
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(page, timeout=5.0) as response:
            text = response.read(1 << 20).decode()
    except (OSError, ValueError):
        return {}
    values = {}
    for line in text.splitlines():
        name, _, value = line.rpartition(" ")
        if name and not line.startswith("#"):
            values[name] = float(value)
    return values


def summed(metrics: Mapping[str, float], name: str) -> float:
    """Return the sum of a family over its labels."""
    return sum(
        value for key, value in metrics.items() if key == name or key.startswith(f"{name}{{")
    )
