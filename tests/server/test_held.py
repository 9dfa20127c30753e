"""What held when faults were done to a relay and its clients, kept so: real processes on loopback.

Calls that go through the same on the virtual clock are in tests/call; clusters in
tests/call/test_cluster.py.
"""

import asyncio
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack, contextmanager, suppress
from pathlib import Path

import pytest
from websockets.exceptions import WebSocketException

from pica_protocol.errors import LocalProtocolError
from pica_protocol.frames import Frame
from pica_protocol.session import Closed
from simnet.cluster import Node, person, until
from simnet.peers import open_websocket, peer_in_room

pytestmark = pytest.mark.realtime

if os.name == "nt":
    pytest.skip("stops relays with Unix signals", allow_module_level=True)

RELAY = [sys.executable, "-m", "pica_command", "relay", "--avatar-store", "none", "--port"]


@contextmanager
def relay(
    *prefix: str, port: int = 0, folder: Path | None = None, **options: object
) -> Iterator[Node]:
    """Run a relay, perhaps through another command, or with other options of a process."""
    ready = (folder or Path(os.devnull)) / "url"
    words = [*prefix, *RELAY, str(port)]
    if folder is not None:
        words += ["--ready-file", str(ready)]
    options = {"stderr": subprocess.PIPE, **options}
    process = subprocess.Popen(words, text=True, **options)  # type: ignore[call-overload]
    try:
        if folder is None:
            url = process.stderr.readline().split()[-1]
        else:
            while not ready.exists():
                assert process.poll() is None
                time.sleep(0.02)
            url = ready.read_text().strip()
        yield Node(process, url)
    finally:
        process.kill()
        process.communicate()


async def call_goes_on(url: str) -> None:
    async with peer_in_room(url, "Ada") as ada, peer_in_room(url, "Bob") as bob:
        await ada.send_frame(b"hello")
        assert (await bob.until(Frame)).payload == b"hello"


def test_a_sender_or_a_viewer_that_is_stopped_for_a_while_goes_on() -> None:
    async def call(node: Node, sender: "subprocess.Popen[bytes]") -> None:
        async with person("bob", node, publishes=False) as bob:
            await until(lambda: len(bob.frames) > 10)
            sender.send_signal(signal.SIGSTOP)
            await asyncio.sleep(3.0)
            sender.send_signal(signal.SIGCONT)
            count = len(bob.frames)
            await until(lambda: len(bob.frames) > count + 10)
            assert bob.left == []
            # A viewer is stopped with the process that it is in: this one.
            time.sleep(3.0)  # noqa: ASYNC251
            count = len(bob.frames)
            await until(lambda: len(bob.frames) > count + 10)
            assert bob.link.reconnects == 0

    with relay() as node:
        words = [sys.executable, "-m", "pica_command", "send", "--url", node.url, "--name", "ada"]
        sender = subprocess.Popen(words, stderr=subprocess.DEVNULL)
        try:
            asyncio.run(call(node, sender))
        finally:
            sender.kill()
            sender.wait()


def test_who_was_in_is_back_when_a_killed_relay_is() -> None:
    async def call(first: Node) -> None:
        port = int(first.url.rpartition(":")[2])
        async with (
            person("ada", first, talks=True) as ada,
            person("bob", first, talks=True) as bob,
        ):
            await until(lambda: ada.sees("bob") and bob.sees("ada"))
            first.kill()
            await asyncio.sleep(1.5)
            with relay(port=port):
                await until(lambda: ada.link.reconnects == 1 and bob.link.reconnects == 1)
                count = len(bob.frames)
                await until(lambda: ada.sees("bob") and len(bob.frames) > count + 10)

    with relay() as node:
        asyncio.run(call(node))


def test_mute_readers_flooders_and_resets_beside_a_call_cost_it_no_frame() -> None:
    async def flood(url: str) -> None:
        async with peer_in_room(url, "Flood", room="flooded") as peer:
            with suppress(LocalProtocolError, WebSocketException):
                await peer.publish(num_frames=20_000, fps=20_000)
            await peer.until(Closed)

    async def reset(host: str, port: int) -> None:
        _, writer = await asyncio.open_connection(host, port)
        writer.write(b"GET / HTTP/1.1\r\n")
        sock = writer.get_extra_info("socket")
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        writer.transport.abort()

    async def call(url: str) -> None:
        host, _, port = url.removeprefix("ws://").rpartition(":")
        async with AsyncExitStack() as stack:
            ada = await stack.enter_async_context(peer_in_room(url, "Ada"))
            bob = await stack.enter_async_context(peer_in_room(url, "Bob", tracks=()))
            for _ in range(50):
                mute = await stack.enter_async_context(open_websocket(url))
                mute.transport.pause_reading()
                stack.callback(mute.transport.abort)
            sending = asyncio.create_task(ada.publish(num_frames=90, fps=30))
            flooding = asyncio.create_task(flood(url))
            for _ in range(500):
                await reset(host, int(port))
                await asyncio.sleep(0.002)
            await sending
            await flooding
            await asyncio.sleep(0.2)
            assert len(bob.arrivals) == 90

    with relay() as node:
        asyncio.run(call(node.url))


def test_a_relay_runs_in_little_memory_without_a_home_and_with_a_log_on_a_full_disk(
    tmp_path: Path,
) -> None:
    limited = ("sh", "-c", 'ulimit -v 150000; exec "$@"', "sh")
    # What glibc reserves for a thread, 64 MiB, counts here though it is no memory. It decides by
    # chance when it does, and with too much of it libuv aborts for want of a thread.
    environment = {**os.environ, "HOME": "/proc", "XDG_CACHE_HOME": "/proc"}
    environment["MALLOC_ARENA_MAX"] = "1"
    full = Path("/dev/full")
    with (
        full.open("w") if full.exists() else (tmp_path / "log").open("w") as log,
        relay(*limited, folder=tmp_path, env=environment, stderr=log) as node,
    ):
        asyncio.run(call_goes_on(node.url))
        node.process.terminate()
        assert node.process.wait(timeout=10) == 0
