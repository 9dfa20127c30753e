"""Rooms full of simulated peers, in one loop of the process that measures.

Latency is from just before a frame's ``send`` to just after the ``recv`` that brought it, both
here, on one clock. So it holds the relay, the kernel on both ways, and the time that the frame
waited here because this process was busy.
"""

import contextlib
import random
import select
import time
from typing import Final

from pica_client.bench.relay.peer import JOIN_TIMEOUT_S, SwarmPeer, Tally
from pica_client.errors import CallProcessError
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
