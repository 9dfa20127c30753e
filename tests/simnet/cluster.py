"""Relays of a cluster as processes, and people in a call who find another relay when theirs dies.

Real processes, a real NATS, real links: nothing here is simulated, so times are the machine's.
"""

import asyncio
import itertools
import random
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress

from pica_client.errors import ClientError
from pica_client.transport.config import LinkConfig
from pica_client.transport.connect import RelayWebsocket, open_websocket
from pica_client.transport.link import Link
from pica_protocol.frames import Frame
from pica_protocol.messages import Joined, KeyframeRequest, PeerJoined, PeerLeft, Track, Whisper
from pica_protocol.session import ClientEvent

FPS = 30.0


class Node:
    """One relay process.

    Attributes:
        url: Where it listens.
        process: The process.
    """

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

    def thaw(self) -> None:
        """Let it go on."""
        self.process.send_signal(signal.SIGCONT)

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
def running_nodes(count: int, nats_url: str, *words: str) -> Iterator[list[Node]]:
    """Run so many relays that share their rooms."""
    processes = [start_relay("--port", "0", "--cluster", nats_url, *words) for _ in range(count)]
    nodes = []
    try:
        for process in processes:
            assert process.stderr is not None
            line = process.stderr.readline()
            assert line.startswith("listening on "), line + process.stderr.read()
            nodes.append(Node(process, line.split()[-1]))
        yield nodes
    finally:
        for process in processes:
            process.kill()
            process.communicate()


class Person:
    """Somebody in a call: sends thirty frames a second, sees the others, comes back if need be.

    Attributes:
        link: The real link.
        others: Names of those who are in the room with them, by peer id.
        left: Names of those who left, in order.
        frames: When each frame came, and the frame.
        joined: The latest place they got.
        error: What the link gave up with.
        payload_bytes: Of a frame when they talk, about.
    """

    def __init__(self, name: str, urls: list[str], *, room: str, publishes: bool) -> None:
        self.name = name
        self.others: dict[str, str] = {}
        self.left: list[str] = []
        self.whispers: list[Whisper] = []
        self.frames: list[tuple[float, Frame]] = []
        self.joined: Joined | None = None
        self.error: Exception | None = None
        self.keyframe_requests = 0
        self.payload_bytes = 40
        self._urls = urls
        self._attempts = 0
        self._needs_keyframe = True
        config = LinkConfig(url=urls[0], room=room, name=name, connect_timeout_s=10.0)
        tracks = (Track(kind="face"),) if publishes else ()

        async def connect(_url: str) -> RelayWebsocket:
            url = self._urls[self._attempts % len(self._urls)]
            self._attempts += 1
            return await open_websocket(url)

        self.link = Link(
            config,
            tracks,
            on_event=self._note,
            connector=connect,
            rng=random.Random(name),
        )

    @property
    def stream(self) -> int:
        """The stream they send on."""
        assert self.joined is not None
        return self.joined.tracks[0].stream

    @property
    def peer_id(self) -> str:
        """Who they are to the others."""
        assert self.joined is not None
        return self.joined.peer_id

    def sees(self, *names: str) -> bool:
        """Say whether exactly these are in the room with them."""
        return sorted(self.others.values()) == sorted(names)

    def say(self, payload: bytes, *, is_keyframe: bool) -> None:
        """Send one frame."""
        captured_us = round(asyncio.get_running_loop().time() * 1e6)
        self.link.send_frame(payload, captured_us, is_keyframe=is_keyframe)

    async def run(self) -> None:
        """Be in the call until cancelled, or until the relay will not have them."""
        try:
            await self.link.run()
        except ClientError as error:
            self.error = error

    async def talk(self) -> None:
        """Send at a steady rate until cancelled."""
        loop = asyncio.get_running_loop()
        start, number = loop.time(), 0
        while True:
            is_keyframe, self._needs_keyframe = self._needs_keyframe, False
            self.say(b"%06d" % number + bytes(self.payload_bytes), is_keyframe=is_keyframe)
            number += 1
            await asyncio.sleep(max(start + number / FPS - loop.time(), 0))

    def longest_gap_s(self, stream: int, since: float, until: float) -> float:
        """Return the longest time between two frames of a stream."""
        times = [t for t, frame in self.frames if frame.stream == stream and since <= t <= until]
        times = [since, *times, until]
        return max(b - a for a, b in itertools.pairwise(times))

    def undecodable(self) -> int:
        """Count frames whose reference is missing: of one layer each refers to the one before."""
        last: dict[int, int] = {}
        missing = 0
        for _, frame in self.frames:
            before = last.get(frame.stream)
            if not frame.is_keyframe and before != (frame.sequence - 1) % 65536:
                missing += 1
            last[frame.stream] = frame.sequence
        return missing

    def _note(self, event: ClientEvent, now: float) -> None:
        match event:
            case Joined():
                self.joined = event
                self.others = {peer.peer_id: peer.name for peer in event.peers}
                self._needs_keyframe = True
            case PeerJoined(peer=peer):
                self.others[peer.peer_id] = peer.name
            case PeerLeft(peer_id=peer_id):
                self.left.append(self.others.pop(peer_id))
            case KeyframeRequest():
                self.keyframe_requests += 1
                self._needs_keyframe = True
            case Whisper():
                self.whispers.append(event)
            case Frame():
                self.frames.append((now, event))


@asynccontextmanager
async def person(
    name: str,
    *nodes: Node,
    room: str = "lobby",
    publishes: bool = True,
    talks: bool = False,
) -> AsyncIterator[Person]:
    """Be in a room on the first of these nodes, or on the next when it is gone; then leave."""
    somebody = Person(name, [node.url for node in nodes], room=room, publishes=publishes)
    tasks = [asyncio.create_task(somebody.run())]
    if talks:
        tasks.append(asyncio.create_task(somebody.talk()))
    try:
        await until(lambda: somebody.joined is not None or somebody.error is not None)
        yield somebody
    finally:
        somebody.link.leave()
        for task in tasks[1:]:
            task.cancel()
        with suppress(TimeoutError):
            await asyncio.wait_for(asyncio.gather(*tasks, return_exceptions=True), 3)


async def until(is_so: Callable[[], bool], timeout_s: float = 15.0) -> float:
    """Wait until something is so; return how long that took.

    Raises:
        AssertionError: It is still not so.
    """
    start = time.monotonic()
    while not is_so():
        assert time.monotonic() - start < timeout_s, "it does not come to that"
        await asyncio.sleep(0.005)
    return time.monotonic() - start
