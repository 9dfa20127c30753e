"""`pica bench relay`: rooms full of simulated peers, and what they cost the relay.

Every peer is a real websocket that publishes one stream and receives those of the others in its
room (`peer`); payloads have the sizes of a coded face (`traffic`). Without an address
the bench starts a relay of its own on a core of its own, and keeps the load on the others.

The fields of its rows stand in ``docs/results.md``. What it does not show: real networks, TLS
(unless --url says wss), slow receivers.
"""

import json
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any, Final

from pica_client.bench.harness import Arguments
from pica_client.bench.relay.figures import (
    close_codes,
    describe,
    merged,
    percentiles,
    relay_percentiles,
)
from pica_client.bench.relay.peer import JOIN_TIMEOUT_S
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
from pica_client.local_call.processes import Child, Children
from pica_client.output import say
from pica_client.stats import describe_machine
from pica_client.transport.config import check_address

SETTLE_S: Final = 1.5
"""Between the first frame and the first that counts: queues and windows find their size."""
OWN_JOINS_PER_S: Final = 400.0
PATIENCE_S: Final = 30.0
"""Seconds that a swarm's answer may take beyond the time of its order."""
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
    processes: int = 1
    """Processes of the load generator."""
    joins_per_s: float | None = None
    """How fast peers come in; by default 40 a second, which a relay's limits allow, and 400 for the
    relay that is started."""
    voices: bool = False
    """Let the peers of each room speak in turn as well, 25 packets a second."""
    relay_arguments: Arguments = ()
    """Further arguments of the relay that is started: --relay-arguments="--port 8765"."""
    seed: int = 0
    """Seed of phases and payload sizes."""

    def __post_init__(self) -> None:
        check_ranges(self, rooms=(1, 10_000), peers=(2, 64), fps=(1, 240), seconds=(0.5, 7200))
        check_ranges(self, processes=(1, min(64, self.rooms)), joins_per_s=(0.1, 10_000))
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
    """The swarms on one server: peers that come, send and count."""

    def __init__(self, config: RelayBenchConfig, target: Target, workers: Workers) -> None:
        """Start the processes; nobody has come yet."""
        self.target = target
        self._config = config
        self._workers = workers
        self._connected = 0
        _, cores = share_cores()
        self._rate = config.joins_per_s or (40.0 if target.pid is None else OWN_JOINS_PER_S)
        names = [self.room(index) for index in range(config.rooms)]
        swarms = [
            SwarmConfig(
                url=target.url,
                rooms=names[part :: config.processes],
                peers=config.peers,
                fps=config.fps,
                joins_per_s=self._rate / config.processes,
                voices=config.voices,
                seed=f"{config.seed}/{part}",
            )
            for part in range(config.processes)
        ]
        self._swarms = [
            workers.start("swarm", json.dumps(asdict(swarm)), core=cores[part % len(cores)])
            for part, swarm in enumerate(swarms)
        ]
        self._idle_bytes = None if target.pid is None else memory_bytes(target.pid)

    @property
    def num_connections(self) -> int:
        """Peers that are there."""
        return self._connected * self._config.peers

    def room(self, index: int) -> str:
        """The name of a room, by its number from 0."""
        return f"load-{self._config.seed}-{index}"

    def connect(self, rooms: int) -> None:
        """Fill the first so many rooms.

        Raises:
            CallProcessError: Not everybody got in.
        """
        if rooms <= self._connected:
            return
        new = (rooms - self._connected) * self._config.peers
        for swarm, part in zip(self._swarms, self._parts(rooms), strict=True):
            swarm.order(do="connect", rooms=part)
        timeout_s = new / self._rate + JOIN_TIMEOUT_S + PATIENCE_S
        answers = [swarm.answer(timeout_s) for swarm in self._swarms]
        live = sum(answer["live"] for answer in answers)
        if live < rooms * self._config.peers:
            raise CallProcessError(
                f"{live} of {rooms * self._config.peers} peers got in; the others were closed "
                f"with {close_codes(answers) or 'no code'}: see the limits of the relay"
            )
        self._connected = rooms

    def measure(self, rooms: int, seconds: float) -> dict[str, Any]:
        """Let the first so many rooms send for a while; return the figures."""
        self.connect(rooms)
        pid, target = self.target.pid, self.target
        begin_s = time.monotonic() + SETTLE_S
        end_s = begin_s + seconds
        for swarm, part in zip(self._swarms, self._parts(rooms), strict=True):
            swarm.order(do="window", rooms=part, begin_s=begin_s, end_s=end_s)
        _sleep_until(begin_s)
        before = relay_metrics(target.url) if target.has_metrics else {}
        cpu_before, at_before = None if pid is None else cpu_s(pid), time.monotonic()
        _sleep_until(end_s)
        cpu_after, at_after = None if pid is None else cpu_s(pid), time.monotonic()
        after = relay_metrics(target.url) if target.has_metrics else {}
        answers = [swarm.answer(DRAIN_S + PATIENCE_S) for swarm in self._swarms]
        metrics = {name: value - before.get(name, 0.0) for name, value in after.items()}
        if "pica_overload" in after:
            metrics["pica_overload"] = after["pica_overload"]  # as it is, no difference
        cpu = None
        if cpu_before is not None and cpu_after is not None:
            cpu = (cpu_after - cpu_before) / (at_after - at_before)
        return self._figures(rooms, seconds, answers, metrics, cpu)

    def leave(self) -> None:
        """End the swarms."""
        self._workers.stop(self._swarms)

    def _figures(
        self,
        rooms: int,
        seconds: float,
        answers: Sequence[dict[str, Any]],
        metrics: dict[str, float],
        cpu: float | None,
    ) -> dict[str, Any]:
        config, closed = self._config, close_codes(answers)
        total: Counter[str] = Counter()
        for answer in answers:
            total.update({key: n for key, n in answer.items() if isinstance(n, int)})
        received = total["received"] + total["voices_received"]
        expected = (total["sent"] + total["voices_sent"]) * (config.peers - 1)
        missing = expected - received
        delivered_per_s = received / seconds
        held = None if self.target.pid is None else memory_bytes(self.target.pid)
        per_connection = None
        if self._idle_bytes is not None and held is not None:
            per_connection = round(max(held - self._idle_bytes, 0) / self.num_connections)
        messages = summed(metrics, "pica_messages_out_total")
        return {
            "rooms": rooms,
            "peers": config.peers,
            "fps": config.fps,
            "seconds": seconds,
            "connections": self.num_connections,
            "delivered_per_s": round(delivered_per_s, 1),
            "sent_per_s": round(total["sent"] / seconds, 1),
            "forward_ms": percentiles(merged(answers, "latency")),
            "voice_ms": percentiles(merged(answers, "voice_latency")) if config.voices else None,
            "relay_forward_ms": relay_percentiles(metrics),
            "dropped": round(summed(metrics, "pica_frames_dropped_total")) if metrics else missing,
            "late": round(metrics.get('pica_frames_dropped_total{reason="late"}', 0.0)),
            "overload": round(metrics.get("pica_overload", 0.0)),
            "missing": missing,
            "voices_missing": total["voices_sent"] * (config.peers - 1) - total["voices_received"],
            "blocked": total["blocked"],
            "relay_cpu_s_per_1000": None
            if cpu is None or not delivered_per_s
            else round(cpu / delivered_per_s * 1000, 5),
            "relay_cpu_ratio": None if cpu is None else round(cpu, 3),
            "bytes_per_connection": per_connection,
            "messages_per_s": round(messages / seconds) if messages else None,
            "bitrate_bps": round(total["bytes_in"] * 8 / seconds / max(rooms * config.peers, 1)),
            "frames_per_message": None
            if not messages
            else round(summed(metrics, "pica_frames_out_total") / messages, 2),
            "errors": sum(closed.values()),
            "close_codes": closed,
            "generator": {
                "processes": config.processes,
                "cpu_ratio": [round(answer["cpu_ratio"], 3) for answer in answers],
                "turn_ms": percentiles(merged(answers, "turn")),
                "reads_per_s": round(total["reads"] / seconds, 1),
            },
        }

    def _parts(self, rooms: int) -> list[int]:
        """How many rooms of each swarm are the first so many of all."""
        num = self._config.processes
        return [(rooms - part + num - 1) // num for part in range(num)]


def run_relay_bench(config: RelayBenchConfig) -> dict[str, Any]:
    """Measure a relay.

    Raises:
        ClientError: The relay does not answer, or does not let everybody in.
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
    relay, target = start_relay(config, children, limits)
    try:
        yield target
    finally:
        relay.let_go()
        relay.wait(time.monotonic() + START_TIMEOUT_S)


def start_relay(
    config: RelayBenchConfig, children: Children, limits: Sequence[str] = NO_LIMITS
) -> tuple[Child, Target]:
    """Start a relay with room for the load, on a core of its own."""
    connections = config.rooms * config.peers + 64
    relay, url = children.start_relay(
        *("--max-connections", str(connections)),
        *("--room-capacity", str(max(config.peers + 2, 16))),
        *limits,
        *config.relay_arguments,
    )
    core, _ = share_cores()
    pin(relay.pid, core)
    return relay, Target(url=url, pid=relay.pid, has_metrics=True)


def measure(
    config: RelayBenchConfig, target: Target, workers: Workers, name: str
) -> dict[str, Any]:
    """Load one server as the configuration says; `name` is what it is called on stderr."""
    load = Load(config, target, workers)
    try:
        load.connect(config.rooms)
        say(f"{name}: {load.num_connections} peers in {config.rooms} rooms")
        result = load.measure(config.rooms, config.seconds)
        say(f"{name}: {describe(result)}")
    finally:
        load.leave()
    return result


def _sleep_until(when_s: float) -> None:
    time.sleep(max(when_s - time.monotonic(), 0.0))
