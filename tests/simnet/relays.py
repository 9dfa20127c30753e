"""Relays and NATS as processes, and people in a call who find another relay when theirs dies.

Real processes, a real NATS, real links: nothing here is simulated, so times are the machine's.
"""

import asyncio
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import pytest

from pica_client.transport.connect import LinkConfig
from pica_client.transport.link import Link
from pica_protocol.messages import Joined, PeerJoined, PeerLeft, Track
from pica_protocol.session import ClientEvent

PROGRAM = shutil.which("nats-server") or shutil.which("nats-server", path="/usr/sbin")
INSTALL = "install it with: sh scripts/system_libraries.sh --nats"

needs_nats = pytest.mark.skipif(PROGRAM is None, reason=f"nats-server is not here; {INSTALL}")


class NatsServer:
    """One server; what it stores outlives a restart."""

    def __init__(self, folder: Path, *, jetstream: bool = True) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.url = f"nats://127.0.0.1:{self.port}"
        self._folder = folder
        self._jetstream = jetstream
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start, or start again, and wait until it listens."""
        assert PROGRAM is not None
        words = [PROGRAM, "-a", "127.0.0.1", "-p", str(self.port)]
        if self._jetstream:
            words += ["-js", "-sd", str(self._folder)]
        self._process = subprocess.Popen(words, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 10
        while time.monotonic() < deadline:
            try:
                with socket.create_connection(("127.0.0.1", self.port), 1) as probe:
                    probe.recv(16)
                    return
            except OSError:
                time.sleep(0.02)
        raise AssertionError("nats-server does not listen")

    def empty(self) -> None:
        """Forget what it has stored; it must not run."""
        shutil.rmtree(self._folder)

    def stop(self) -> None:
        """Kill it."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


PATIENCE_S = 60.0
"""How long anything may take; a machine with ten times too much to do has needed 15."""


class RelayProcess:
    """One relay process, and where it listens."""

    def __init__(self, process: subprocess.Popen[str], url: str) -> None:
        self.process = process
        self.url = url

    def kill(self) -> None:
        """Kill it as the kernel does a process that has taken too much memory."""
        self.process.kill()
        self.process.wait()

    def freeze(self) -> None:
        """Stop it without ending it."""
        self.process.send_signal(signal.SIGSTOP)

    def page(self, path: str) -> str:
        """Fetch a status page; blocks."""
        with urllib.request.urlopen(f"http{self.url[2:]}{path}", timeout=5) as response:
            text: str = response.read().decode()
            return text

    def number(self, name: str) -> float:
        """Fetch one of its numbers; 0 if it has not been counted yet. Blocks."""
        for line in self.page("/metrics").splitlines():
            if line.startswith(f"pica_{name} "):
                return float(line.split()[-1])
        return 0.0


def start_relay(*words: str) -> subprocess.Popen[str]:
    """Start a relay on a free port, without waiting for it."""
    command = [sys.executable, "-m", "pica_command", "relay", "--avatar-store", "none", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@contextmanager
def running_relays(count: int, nats_url: str, *words: str) -> Iterator[list[RelayProcess]]:
    """Run so many relays that place their rooms over one NATS."""
    processes = [start_relay("--port", "0", "--cluster", nats_url, *words) for _ in range(count)]
    relays = []
    try:
        for process in processes:
            assert process.stderr is not None
            line = process.stderr.readline()
            assert line.startswith("listening on "), line + process.stderr.read()
            relays.append(RelayProcess(process, line.split()[-1]))
        yield relays
    finally:
        for process in processes:
            process.kill()
            process.communicate()


class Person:
    """A participant, with a face track that says nothing; `others` are the names of those in the
    room with them, by peer id."""

    def __init__(self, name: str, url: str, *, room: str) -> None:
        self.name = name
        self.others: dict[str, str] = {}
        self.has_joined = False
        config = LinkConfig(url=url, room=room, name=name, connect_timeout_s=PATIENCE_S)
        self.link = Link(config, (Track(kind="face"),), on_event=self._note)

    def sees(self, *names: str) -> bool:
        """Return True if exactly these are in the room with them."""
        return sorted(self.others.values()) == sorted(names)

    def _note(self, event: ClientEvent, _now: float) -> None:
        match event:
            case Joined():
                self.has_joined = True
                self.others = {peer.peer_id: peer.name for peer in event.peers}
            case PeerJoined(peer=peer):
                self.others[peer.peer_id] = peer.name
            case PeerLeft(peer_id=peer_id):
                del self.others[peer_id]


@asynccontextmanager
async def person(name: str, relay: RelayProcess, room: str = "lobby") -> AsyncIterator[Person]:
    """Be in a room, by asking one relay for it; then leave."""
    somebody = Person(name, relay.url, room=room)
    running = asyncio.create_task(somebody.link.run())
    try:
        await until(lambda: somebody.has_joined or running.done())
        yield somebody
    finally:
        somebody.link.leave()
        await running


async def until(is_so: Callable[[], bool]) -> float:
    """Wait until something is so; return how long that took."""
    start = time.monotonic()
    while not is_so():
        assert time.monotonic() - start < PATIENCE_S, "it does not come to that"
        await asyncio.sleep(0.005)
    return time.monotonic() - start
