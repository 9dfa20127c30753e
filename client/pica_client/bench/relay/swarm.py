"""A process full of simulated peers: ``python -m pica_client.bench.relay.swarm``.

One loop: send the frames that are due, wait, read what has come. It takes its orders from standard
input, a JSON object a line, and answers each with one on standard output; when the input ends, so
does it. Orders: ``connect`` (come in, so many a second) and ``window`` (send, and count the frames
captured between two moments).

What is measured: from just before a frame's ``send`` to just after the ``recv`` that brought it,
both here, on the clock that all processes of a machine share. So it holds the relay, the kernel on
both ways, and the time that the frame waited here because this process was busy; ``turn_us`` bounds
the last: how long the loop needed from one look at the sockets to the next, naps not counted.
"""

import contextlib
import json
import math
import os
import random
import select
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from pica_client.bench.relay.peer import JOIN_TIMEOUT_S, SwarmPeer
from pica_client.bench.relay.tally import Tally, add_step
from pica_client.errors import ClientError

NAP_S: Final = 0.0002
"""Between two looks at the sockets under load: adds as much to the latencies at most (chosen)."""
TURN_US: Final = 2_000_000
"""How long each speaks (chosen: a sentence)."""
VOICE_S: Final = 0.04
"""Between two packets of a voice."""
DRAIN_S: Final = 1.0
"""After a window, for frames that are still under way."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SwarmConfig:
    """Who connects to what."""

    url: str
    rooms: list[str]
    """Names of this process's rooms."""
    peers: int
    """Number of peers in each room."""
    fps: float
    joins_per_s: float
    """How fast to come in."""
    voices: bool
    """Whether the peers of a room speak in turn."""
    seed: str


class _Schedule:
    """When who sends: each once in an interval, at a moment of its own.

    Attributes:
        length: How many there are.
    """

    def __init__(self, send: Sequence[Callable[[int], None]], interval_s: float, seed: str) -> None:
        """Spread the senders evenly at random over one interval."""
        phases = random.Random(seed)
        entries = [(phases.random() * interval_s, each) for each in send]
        self._entries = sorted(entries, key=lambda item: item[0])
        self.length = len(self._entries)
        self._interval_s = interval_s
        self._next, self._cycle_s = 0, time.monotonic()

    def send_due(self) -> float:
        """Let send who is due; return when the next one is."""
        entries, monotonic_ns = self._entries, time.monotonic_ns
        while True:
            phase_s, send = entries[self._next]
            now_us = monotonic_ns() // 1000
            due_s = self._cycle_s + phase_s
            if due_s * 1e6 > now_us:
                return due_s
            send(now_us)
            self._next += 1
            if self._next == self.length:
                self._next = 0
                # After a stall frames are skipped, not sent in a burst: a camera does not wait.
                behind = (now_us / 1e6 - self._cycle_s) / self._interval_s
                self._cycle_s += max(int(behind), 1) * self._interval_s


class Swarm:
    """All peers of this process and the loop that drives them."""

    def __init__(self, config: SwarmConfig) -> None:
        self._config = config
        self._rng = random.Random(config.seed)
        self._poller = select.poll() if not hasattr(select, "epoll") else select.epoll()
        self._by_fd: dict[int, SwarmPeer] = {}
        self._rooms: list[list[SwarmPeer]] = [[] for _ in config.rooms]
        self._schedules: list[_Schedule] = []  # of faces; of voices, one a room
        self._tally = Tally()
        self._input = b""
        self._is_over = False
        self._poller.register(sys.stdin.fileno(), select.POLLIN)

    def run(self) -> None:
        """Obey until the input ends."""
        while (order := self._next_order()) is not None:
            match order.pop("do"):
                case "connect":
                    self._connect(**order)
                case "window":
                    self._measure(**order)
        for peer in self._by_fd.values():
            peer.close()

    def _connect(self, rooms: int) -> None:
        """Let the first so many rooms be full, and answer when they are."""
        config = self._config
        due_s = time.monotonic()
        new: list[SwarmPeer] = []
        for name, room in zip(config.rooms[:rooms], self._rooms, strict=False):
            while len(room) < config.peers:
                while time.monotonic() < due_s:
                    self._turn(due_s)
                due_s += 1 / config.joins_per_s
                peer = SwarmPeer(
                    config.url,
                    name,
                    f"load-{len(room)}",
                    self._rng,
                    self._tally,
                    time.monotonic(),
                    has_voice=config.voices,
                )
                room.append(peer)
                self._by_fd[peer.sock.fileno()] = peer
                self._poller.register(peer.sock.fileno(), select.POLLIN)
                new.append(peer)
        deadline = time.monotonic() + JOIN_TIMEOUT_S
        while not all(peer.is_live or peer.is_closed for peer in new):
            if time.monotonic() > deadline or self._is_over:
                break
            self._turn(time.monotonic() + 0.05)
        live = sum(peer.is_live for room in self._rooms for peer in room)
        _answer({"live": live, "closed": dict(self._tally.codes)})

    def _measure(self, rooms: int, begin_s: float, end_s: float) -> None:
        """Let the first so many rooms send until the end, and count from the beginning."""
        self._start_sending(rooms)
        tally = self._tally
        tally.begin(int(begin_s * 1e6), int(end_s * 1e6))
        cpu_s = 0.0
        has_begun = False
        while (now := time.monotonic()) < end_s and not self._is_over:
            if not has_begun and now >= begin_s:
                has_begun, cpu_s = True, time.process_time()
            self._turn(end_s)
        cpu_s = time.process_time() - cpu_s
        drained_s = end_s + DRAIN_S
        others = self._config.peers - 1
        while time.monotonic() < drained_s and (
            tally.num_received < tally.sent * others
            or tally.voices_received < tally.voices_sent * others
        ):
            self._turn(time.monotonic() + 0.1)
        cpu_ratio = cpu_s / max(end_s - begin_s, 1e-9)
        _answer({**tally.as_dict(), "closed": dict(tally.codes), "cpu_ratio": cpu_ratio})

    def _start_sending(self, rooms: int) -> None:
        """Let the peers of the first so many rooms send."""
        config, sending = self._config, self._rooms[:rooms]
        peers = [peer for room in sending for peer in room]
        if self._schedules and self._schedules[0].length == len(peers):
            return
        faces = [partial(self._send_face, peer) for peer in peers]
        self._schedules = [_Schedule(faces, 1 / config.fps, f"{config.seed}/phases")]
        if config.voices:
            voices = [partial(self._send_voice, room) for room in sending]
            self._schedules.append(_Schedule(voices, VOICE_S, f"{config.seed}/voices"))

    def _send_face(self, peer: SwarmPeer, now_us: int) -> None:
        if peer.is_live:
            tally, is_sent = self._tally, peer.send_frame(now_us)
            if tally.covers(now_us):
                tally.sent += is_sent
                tally.blocked += not is_sent

    def _send_voice(self, room: Sequence[SwarmPeer], now_us: int) -> None:
        """Let speak whose turn it is."""
        peer = room[now_us // TURN_US % len(room)]
        if peer.is_live:
            tally, is_sent = self._tally, peer.send_voice(now_us)
            if tally.covers(now_us):
                tally.voices_sent += is_sent
                tally.blocked += not is_sent

    def _turn(self, until_s: float) -> None:
        """Send what is due, wait for something to read or for the next frame, and read."""
        due_s = min([until_s, *(each.send_due() for each in self._schedules)])
        if self._schedules:
            # Under load, look at the sockets now and then instead of waiting for them: waking this
            # process would be work for the sender of what it waits for, as much as the sending.
            ready = self._poller.poll(0)
            if not ready and (left_s := due_s - time.monotonic()) > 0:
                time.sleep(min(NAP_S, left_s))
        else:
            timeout_ms = math.ceil(max(due_s - time.monotonic(), 0.0) * 1e3)
            is_epoll = isinstance(self._poller, select.epoll)
            ready = self._poller.poll(timeout_ms / 1e3 if is_epoll else timeout_ms)
        if not ready:
            return
        begin_ns = time.monotonic_ns()
        now = begin_ns / 1e9
        for fd, _ in ready:
            peer = self._by_fd.get(fd)
            if peer is None:
                self._read_orders()
                continue
            peer.on_readable(now)
            if peer.is_closed:
                del self._by_fd[fd]
                with contextlib.suppress(OSError, KeyError):  # epoll has forgotten it already
                    self._poller.unregister(fd)
        add_step(self._tally.turns, (time.monotonic_ns() - begin_ns) // 1000)

    def _next_order(self) -> dict[str, Any] | None:
        while b"\n" not in self._input and not self._is_over:
            self._turn(time.monotonic() + 0.5)
        line, newline, self._input = self._input.partition(b"\n")
        return json.loads(line) if newline else None

    def _read_orders(self) -> None:
        data = os.read(sys.stdin.fileno(), 65_536)
        self._input += data
        if not data:
            self._is_over = True
            self._poller.unregister(sys.stdin.fileno())


def _answer(values: dict[str, Any]) -> None:
    print(json.dumps(values), flush=True)


def main() -> None:
    """Read the configuration from the first argument and obey."""
    swarm = Swarm(SwarmConfig(**json.loads(sys.argv[1])))
    try:
        swarm.run()
    except ClientError as error:
        _answer({"error": str(error)})
        sys.exit(error.exit_code)


if __name__ == "__main__":
    main()
