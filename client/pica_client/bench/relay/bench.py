"""`pica bench relay`: rooms full of simulated peers, and what they cost the relay.

Every peer is a real websocket that publishes one stream and receives those of the others in its
room (`peer`); one loop drives all of them. The relay is a process of its own, on a core of its own.
Latency is from just before a frame's ``send`` to just after the ``recv`` that brought it, both
here, on one clock. So it holds the relay, the kernel on both ways, and the time that the frame
waited here because this process was busy.

What it does not show: real networks, TLS, slow receivers.
"""

import contextlib
import os
import random
import select
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pica_client.bench.relay.peer import JOIN_TIMEOUT_S, SwarmPeer, Tally
from pica_client.errors import CallProcessError, check_ranges
from pica_client.local_call.processes import Children
from pica_client.stats import describe_machine, summarise_ms
from pica_client.system import say, terminate_as_interrupt
from pica_protocol.frames import TICK_US

FPS: Final = 30.0
"""Frames a second of each peer."""
JOINS_PER_S: Final = 400.0
NAP_S: Final = 0.0002
"""Between two looks at the sockets under load: adds as much to the latencies at most (chosen)."""
DRAIN_S: Final = 1.0
"""After a measurement, for frames that are still on their way."""


class Swarm:
    """Peers that join one server, send and count.

    Attributes:
        tally: What they have counted.
    """

    def __init__(self) -> None:
        self.tally = Tally()
        self._rng = random.Random(0)  # phases and sizes
        self._poller = select.poll() if not hasattr(select, "epoll") else select.epoll()
        self._by_fd: dict[int, SwarmPeer] = {}
        self._peers: list[SwarmPeer] = []
        # Each sends once in an interval, at a moment of its own: phase and peer, in order.
        self._schedule: list[tuple[float, SwarmPeer]] = []
        self._next, self._cycle_s = 0, 0.0

    def join(self, url: str, num_rooms: int, num_peers: int) -> None:
        """Fill rooms with so many peers each, and wait until all are in.

        Raises:
            RelayUnreachableError: Nothing listens there.
            CallProcessError: Some were refused.
        """
        due_s = time.monotonic()
        for room in range(num_rooms):
            for number in range(num_peers):
                while time.monotonic() < due_s:
                    self._turn(due_s)
                due_s += 1 / JOINS_PER_S
                peer = SwarmPeer(url, f"load-{room}", f"load-{number}", self._rng, self.tally)
                self._peers.append(peer)
                self._by_fd[peer.sock.fileno()] = peer
                self._poller.register(peer.sock.fileno(), select.POLLIN)
        deadline = time.monotonic() + JOIN_TIMEOUT_S
        while not all(peer.is_live or peer.is_closed for peer in self._peers):
            if time.monotonic() > deadline:
                break
            self._turn(time.monotonic() + 0.05)
        num_live = sum(peer.is_live for peer in self._peers)
        if num_live < len(self._peers):
            raise CallProcessError(
                f"{num_live} of {len(self._peers)} peers joined; the others were closed with "
                f"{dict(self.tally.codes) or 'no code'}: see the limits of the relay"
            )
        phases = [self._rng.random() / FPS for _ in self._peers]
        self._schedule = sorted(zip(phases, self._peers, strict=True), key=lambda item: item[0])
        self._cycle_s = time.monotonic()

    def send(self, seconds: float) -> None:
        """Let all peers send for a while."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self._turn(end_s)

    def measure(self, seconds: float) -> None:
        """Send for a while, and count the frames that were captured meanwhile."""
        # Whole ticks, as capture times come back from the wire.
        self.tally.begin_us = (time.monotonic_ns() // 1000 // TICK_US + 1) * TICK_US
        self.tally.end_us = self.tally.begin_us + round(seconds * 1e6 / TICK_US) * TICK_US
        self.send(seconds)

    def drain(self, expected: int) -> None:
        """Wait until so many frames have been received, or it is late."""
        deadline = time.monotonic() + DRAIN_S
        while time.monotonic() < deadline and len(self.tally.delays_us) < expected:
            self._turn(time.monotonic() + 0.1)

    def close(self) -> None:
        """Cut all connections."""
        for peer in self._peers:
            peer.close()

    def _send_due(self) -> float:
        """Send what is due; return when the next frame is."""
        while True:
            phase_s, peer = self._schedule[self._next]
            now_us = time.monotonic_ns() // 1000
            due_s = self._cycle_s + phase_s
            if due_s * 1e6 > now_us:
                return due_s
            peer.send_frame(now_us)
            self._next += 1
            if self._next == len(self._schedule):
                self._next = 0
                # After a stall frames are skipped, not sent in a burst: a camera does not wait.
                behind = (now_us / 1e6 - self._cycle_s) * FPS
                self._cycle_s += max(int(behind), 1) / FPS

    def _turn(self, until_s: float) -> None:
        """Send what is due, and read what has come; nap if that is nothing.

        Under load it looks at the sockets now and then instead of waiting for them: waking this
        process would be work for the sender of what it waits for, as much as the sending.
        """
        due_s = min(until_s, self._send_due()) if self._schedule else until_s
        ready = self._poller.poll(0)
        if not ready:
            time.sleep(min(NAP_S, max(due_s - time.monotonic(), 0.0)))
            return
        now = time.monotonic()
        for fd, _ in ready:
            peer = self._by_fd[fd]
            peer.on_readable(now)
            if peer.is_closed:
                del self._by_fd[fd]
                with contextlib.suppress(OSError, KeyError):  # epoll has forgotten it already
                    self._poller.unregister(fd)


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
