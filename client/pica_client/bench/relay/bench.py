"""`pica bench relay`: rooms full of simulated peers, and what they cost the relay.

Every peer is a real websocket that publishes one stream and receives those of the others in its
room (`peer`), all in one process (`swarm`). Without an address the bench starts a relay of its own
on a core of its own. What it does not show: real networks, TLS (unless --url says wss), slow
receivers.
"""

import json
import time
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import accumulate
from typing import Any, Final

from pica_client.bench.harness import Arguments
from pica_client.bench.relay.peer import JOIN_TIMEOUT_S, STEP_US
from pica_client.bench.relay.processes import (
    START_TIMEOUT_S,
    Workers,
    cpu_s,
    memory_bytes,
    pin,
    relay_metrics,
    share_cores,
    summed,
)
from pica_client.bench.relay.swarm import DRAIN_S, SwarmConfig
from pica_client.errors import CallProcessError, check_ranges
from pica_client.local_call.processes import Children
from pica_client.output import say
from pica_client.stats import describe_machine
from pica_client.transport.config import check_address

SETTLE_S: Final = 1.5
"""Between the first frame and the first that counts: queues and windows find their size."""
OWN_JOINS_PER_S: Final = 400.0
FOREIGN_JOINS_PER_S: Final = 40.0
"""Of a relay that runs already; its limits allow so many."""
PATIENCE_S: Final = 30.0
"""Seconds that an answer of the swarm may take beyond the time of its work."""
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


class Load:
    """Peers that join one server, send and count."""

    def __init__(self, config: RelayBenchConfig, target: Target, workers: Workers) -> None:
        """Start the process; no peer has joined yet."""
        self.target = target
        self._config, self._workers = config, workers
        self._rate = FOREIGN_JOINS_PER_S if target.pid is None else OWN_JOINS_PER_S
        swarm = SwarmConfig(
            url=target.url,
            rooms=[self.room(index) for index in range(config.rooms)],
            peers=config.peers,
            fps=config.fps,
            joins_per_s=self._rate,
            seed=config.seed,
        )
        self._idle_bytes = None if target.pid is None else memory_bytes(target.pid)
        self._swarm = workers.start("swarm", json.dumps(asdict(swarm)), core=share_cores()[1])

    @property
    def num_connections(self) -> int:
        """Number of peers."""
        return self._config.rooms * self._config.peers

    def room(self, index: int) -> str:
        """The name of a room, by its number from 0."""
        return f"load-{self._config.seed}-{index}"

    def connect(self) -> None:
        """Wait until all peers are in their rooms.

        Raises:
            CallProcessError: Some were refused.
        """
        answer = self._swarm.answer(self.num_connections / self._rate + JOIN_TIMEOUT_S + PATIENCE_S)
        if answer["live"] < self.num_connections:
            raise CallProcessError(
                f"{answer['live']} of {self.num_connections} peers joined; the others were closed "
                f"with {answer['closed'] or 'no code'}: see the limits of the relay"
            )

    def measure(self) -> dict[str, Any]:
        """Let all peers send for a while; return the figures."""
        target, seconds = self.target, self._config.seconds
        begin_s = time.monotonic() + SETTLE_S
        end_s = begin_s + seconds
        self._swarm.order(json.dumps([begin_s, end_s]))
        readings = []
        for moment_s in (begin_s, end_s):
            time.sleep(max(moment_s - time.monotonic(), 0.0))
            metrics = relay_metrics(target.url) if target.has_metrics else {}
            cpu = None if target.pid is None else cpu_s(target.pid)
            readings.append((metrics, cpu, time.monotonic()))
        counted = self._swarm.answer(DRAIN_S + PATIENCE_S)
        (before, cpu_before, at_before), (after, cpu_after, at_after) = readings
        metrics = {name: value - before.get(name, 0.0) for name, value in after.items()}
        cpu_ratio = None
        if cpu_before is not None and cpu_after is not None:
            cpu_ratio = (cpu_after - cpu_before) / (at_after - at_before)
        overload = round(after.get("pica_overload", 0.0))
        return self._figures(counted, metrics, cpu_ratio) | {"overload": overload}

    def leave(self) -> None:
        """End the process."""
        self._workers.stop([self._swarm])

    def _figures(
        self, counted: dict[str, Any], metrics: dict[str, float], cpu_ratio: float | None
    ) -> dict[str, Any]:
        config = self._config
        missing = counted["sent"] * (config.peers - 1) - counted["received"]
        delivered_per_s = counted["received"] / config.seconds
        held = None if self.target.pid is None else memory_bytes(self.target.pid)
        per_connection = None
        if self._idle_bytes is not None and held is not None:
            per_connection = round(max(held - self._idle_bytes, 0) / self.num_connections)
        messages = summed(metrics, "pica_messages_out_total")
        frames = summed(metrics, "pica_frames_out_total")
        return {
            "rooms": config.rooms,
            "peers": config.peers,
            "fps": config.fps,
            "seconds": config.seconds,
            "connections": self.num_connections,
            "delivered_per_s": round(delivered_per_s, 1),
            "sent_per_s": round(counted["sent"] / config.seconds, 1),
            "forward_ms": percentiles(counted["latency"]),
            "dropped": round(summed(metrics, "pica_frames_dropped_total")) if metrics else missing,
            "late": round(metrics.get('pica_frames_dropped_total{reason="late"}', 0.0)),
            "missing": missing,
            "blocked": counted["blocked"],
            "relay_cpu_s_per_1000": None
            if cpu_ratio is None or not delivered_per_s
            else round(cpu_ratio / delivered_per_s * 1000, 5),
            "relay_cpu_ratio": None if cpu_ratio is None else round(cpu_ratio, 3),
            "bytes_per_connection": per_connection,
            "frames_per_message": round(frames / messages, 2) if messages else None,
            "errors": sum(counted["closed"].values()),
            "close_codes": counted["closed"],
            "generator_cpu_ratio": round(counted["cpu_ratio"], 3),
            "generator_turn_ms": percentiles(counted["turn"]),
        }


def percentiles(steps: Mapping[str, int]) -> dict[str, float | None]:
    """Percentiles of a histogram of steps of `STEP_US`, upper edges, in milliseconds."""
    counts = {int(step): count for step, count in steps.items()}
    ordered = sorted(counts)
    seen = list(accumulate(counts[step] for step in ordered))
    found: dict[str, float | None] = {}
    for percent in (50, 95, 99):
        place = bisect_left(seen, seen[-1] * percent / 100) if seen else None
        ms = None if place is None else round((ordered[place] + 1) * STEP_US / 1e3, 3)
        found[f"p{percent}"] = ms
    return found


def run_relay_bench(config: RelayBenchConfig) -> dict[str, Any]:
    """Measure a relay.

    Raises:
        ClientError: The relay does not answer, or refuses peers.
    """
    with Workers() as workers, Children() as children, relay_target(config, children) as target:
        return measure(config, target, workers, "relay") | {"machine": describe_machine()}


@contextmanager
def relay_target(
    config: RelayBenchConfig, children: Children, limits: Sequence[str] = NO_LIMITS
) -> Iterator[Target]:
    """The relay under load: the one at the address, or one of our own on its own core."""
    if config.url is not None:
        yield Target(url=config.url, has_metrics=bool(relay_metrics(config.url)))
        return
    relay, url = children.start_relay(
        *("--max-connections", str(config.rooms * config.peers + 64)),
        *("--room-capacity", str(max(config.peers + 2, 16))),
        *limits,
        *config.relay_arguments,
    )
    pin(relay.pid, share_cores()[0])
    try:
        yield Target(url=url, pid=relay.pid, has_metrics=True)
    finally:
        relay.let_go()
        relay.wait(time.monotonic() + START_TIMEOUT_S)


def measure(
    config: RelayBenchConfig, target: Target, workers: Workers, name: str
) -> dict[str, Any]:
    """Load one server as the configuration says; `name` is what it is called on stderr."""
    load = Load(config, target, workers)
    try:
        load.connect()
        say(f"{name}: {load.num_connections} peers in {config.rooms} rooms")
        result = load.measure()
    finally:
        load.leave()
    forward = result["forward_ms"]
    say(
        f"{name}: {result['delivered_per_s']:,.0f} frames/s delivered, forwarding p50 "
        f"{forward['p50']} ms, p99 {forward['p99']} ms, missing {result['missing']}, processor "
        f"{result['relay_cpu_s_per_1000']} s per 1,000"
    )
    return result
