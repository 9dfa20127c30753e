"""A process full of simulated peers: ``python -m pica_client.bench.relay.swarm``.

It joins all peers and prints how many are in their rooms. A line on standard input then says when
the measurement begins and ends (`time.monotonic`); it sends until the end and prints what it
counted. Both answers are a JSON object a line. It ends when its input does.

What is measured: from just before a frame's ``send`` to just after the ``recv`` that brought it,
both here, on one clock. So it holds the relay, the kernel on both ways, and the time that the frame
waited here because this process was busy; ``turn`` bounds the last: how long the loop needed from
one look at the sockets to the next, naps not counted.
"""

import contextlib
import json
import math
import os
import random
import select
import sys
import time
from collections import Counter
from dataclasses import dataclass
from typing import Any, Final

from pica_client.bench.relay.peer import JOIN_TIMEOUT_S, STEP_US, SwarmPeer, Tally
from pica_client.errors import ClientError

NAP_S: Final = 0.0002
"""Between two looks at the sockets under load: adds as much to the latencies at most (chosen)."""
DRAIN_S: Final = 1.0
"""After a measurement, for frames that are still on their way."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SwarmConfig:
    """Who connects to what."""

    url: str
    rooms: list[str]
    """Names of the rooms."""
    peers: int
    """Number of peers in each room."""
    fps: float
    joins_per_s: float
    seed: int


class Swarm:
    """All peers and the loop that drives them."""

    def __init__(self, config: SwarmConfig) -> None:
        self._config = config
        self._rng = random.Random(config.seed)
        self._poller = select.poll() if not hasattr(select, "epoll") else select.epoll()
        self._peers: list[SwarmPeer] = []
        self._by_fd: dict[int, SwarmPeer] = {}
        # Each sends once in an interval, at a moment of its own: phase and peer, in order.
        self._schedule: list[tuple[float, SwarmPeer]] = []
        self._next, self._cycle_s = 0, 0.0
        self._tally = Tally()
        self._turns: Counter[int] = Counter()
        self._input = b""
        self._is_over = False
        self._poller.register(sys.stdin.fileno(), select.POLLIN)

    def run(self) -> None:
        """Join, wait for the order, send and count."""
        self._connect()
        while b"\n" not in self._input and not self._is_over:
            self._turn(time.monotonic() + 0.5)
        if not self._is_over:
            self._measure(*json.loads(self._input))
        for peer in self._peers:
            peer.close()

    def _connect(self) -> None:
        config = self._config
        due_s = time.monotonic()
        for room in config.rooms:
            for number in range(config.peers):
                while time.monotonic() < due_s:
                    self._turn(due_s)
                due_s += 1 / config.joins_per_s
                peer = SwarmPeer(config.url, room, f"load-{number}", self._rng, self._tally)
                self._peers.append(peer)
                self._by_fd[peer.sock.fileno()] = peer
                self._poller.register(peer.sock.fileno(), select.POLLIN)
        deadline = time.monotonic() + JOIN_TIMEOUT_S
        while not all(peer.is_live or peer.is_closed for peer in self._peers):
            if time.monotonic() > deadline or self._is_over:
                break
            self._turn(time.monotonic() + 0.05)
        self._answer(live=sum(peer.is_live for peer in self._peers))

    def _measure(self, begin_s: float, end_s: float) -> None:
        """Send until the end, and count from the beginning."""
        phases = [self._rng.random() / self._config.fps for _ in self._peers]
        self._schedule = sorted(zip(phases, self._peers, strict=True), key=lambda item: item[0])
        self._cycle_s = time.monotonic()
        tally = self._tally
        tally.begin_us, tally.end_us = int(begin_s * 1e6), int(end_s * 1e6)
        while time.monotonic() < begin_s and not self._is_over:
            self._turn(begin_s)
        cpu_s = time.process_time()
        while time.monotonic() < end_s and not self._is_over:
            self._turn(end_s)
        cpu_s = time.process_time() - cpu_s
        expected = tally.sent * (self._config.peers - 1)
        while time.monotonic() < end_s + DRAIN_S and tally.received < expected:
            self._turn(time.monotonic() + 0.1)
        self._answer(
            sent=tally.sent,
            blocked=tally.blocked,
            received=tally.received,
            bytes_in=tally.bytes_in,
            latency=tally.latency,
            turn=self._turns,
            cpu_ratio=cpu_s / (end_s - begin_s),
        )

    def _send_due(self) -> float:
        """Send what is due; return when the next frame is."""
        interval_s = 1 / self._config.fps
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
                behind = (now_us / 1e6 - self._cycle_s) / interval_s
                self._cycle_s += max(int(behind), 1) * interval_s

    def _turn(self, until_s: float) -> None:
        """Send what is due, wait for something to read or for the next frame, and read."""
        if self._schedule:
            # Under load, look at the sockets now and then instead of waiting for them: waking this
            # process would be work for the sender of what it waits for, as much as the sending.
            due_s = min(until_s, self._send_due())
            ready = self._poller.poll(0)
            if not ready and (left_s := due_s - time.monotonic()) > 0:
                time.sleep(min(NAP_S, left_s))
        else:
            timeout_ms = math.ceil(max(until_s - time.monotonic(), 0.0) * 1e3)
            is_epoll = isinstance(self._poller, select.epoll)
            ready = self._poller.poll(timeout_ms / 1e3 if is_epoll else timeout_ms)
        if not ready:
            return
        begin_ns = time.monotonic_ns()
        for fd, _ in ready:
            peer = self._by_fd.get(fd)
            if peer is None:
                self._read_input()
                continue
            peer.on_readable(begin_ns / 1e9)
            if peer.is_closed:
                del self._by_fd[fd]
                with contextlib.suppress(OSError, KeyError):  # epoll has forgotten it already
                    self._poller.unregister(fd)
        self._turns[(time.monotonic_ns() - begin_ns) // 1000 // STEP_US] += 1

    def _read_input(self) -> None:
        data = os.read(sys.stdin.fileno(), 65_536)
        self._input += data
        if not data:
            self._is_over = True
            self._poller.unregister(sys.stdin.fileno())

    def _answer(self, **values: Any) -> None:
        print(json.dumps(values | {"closed": self._tally.codes}), flush=True)


def main() -> None:
    """Read the configuration from the first argument and run."""
    swarm = Swarm(SwarmConfig(**json.loads(sys.argv[1])))
    try:
        swarm.run()
    except ClientError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        sys.exit(error.exit_code)


if __name__ == "__main__":
    main()
