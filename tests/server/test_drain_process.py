"""Draining real processes: nothing of control is lost, and clients find the other relay."""

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from pica_client.transport.config import LinkConfig
from pica_client.transport.link import Link
from pica_protocol.messages import Joined
from simnet.peers import peer_in_room

pytestmark = pytest.mark.realtime

if os.name == "nt":
    pytest.skip("stops the relay with Unix signals", allow_module_level=True)

Relay = tuple["subprocess.Popen[str]", str]


@contextmanager
def relay(*arguments: str) -> Iterator[Relay]:
    process = subprocess.Popen(
        [sys.executable, "-m", "pica_command", "relay", "--port", "0", "--json", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        assert line.startswith("listening on "), line + process.stderr.read()
        yield process, line.split()[-1]
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def test_clients_go_to_the_relay_that_they_are_told_of() -> None:
    async def call(first: "subprocess.Popen[str]", url: str, other: str) -> list[float]:
        joined: asyncio.Queue[float] = asyncio.Queue()
        links = []

        def note(event: object, now: float) -> None:
            if isinstance(event, Joined):
                joined.put_nowait(now)

        for i in range(3):
            config = LinkConfig(url=url, room=f"r{i}", name="guest")
            links.append(Link(config, on_event=note))
        running = [asyncio.create_task(link.run()) for link in links]
        async with asyncio.timeout(30):
            for _ in links:
                await joined.get()
            start = asyncio.get_running_loop().time()
            first.send_signal(signal.SIGTERM)
            gaps_s = [await joined.get() - start for _ in links]
            assert all(link.is_joined and link.url == other for link in links)
            for link in links:
                link.leave()
            await asyncio.gather(*running)
        return gaps_s

    with relay() as (_, other), relay("--drain-to", other) as (first, url):
        gaps_s = asyncio.run(call(first, url, other))
        _, stderr = first.communicate(timeout=30)
    assert first.returncode == 0, stderr
    assert max(gaps_s) < 10  # much less in fact; a second try would wait no longer than that


def test_a_second_signal_ends_a_drain_at_once() -> None:
    async def stubborn(process: "subprocess.Popen[str]", url: str) -> None:
        async with peer_in_room(url, "Ada") as ada:
            # A peer that reads nothing keeps the drain waiting.
            transport = ada.websocket.transport
            transport.pause_reading()  # type: ignore[attr-defined]
            process.send_signal(signal.SIGTERM)
            assert process.stderr is not None
            line = await asyncio.to_thread(process.stderr.readline)
            while not line.startswith("draining"):
                line = await asyncio.to_thread(process.stderr.readline)
            await asyncio.sleep(0.2)
            assert process.poll() is None
            process.send_signal(signal.SIGTERM)
            await asyncio.to_thread(process.wait, 60)
            transport.abort()

    with relay("--drain-s", "600") as (process, url):
        start = time.monotonic()
        asyncio.run(stubborn(process, url))
        assert process.returncode == 0
        assert time.monotonic() - start < 60  # of the 600 that it might have taken
