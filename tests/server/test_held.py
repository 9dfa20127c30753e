"""A relay as a real process with little memory, no home and a log on a full disk.

Faults of a whole call are in ``tests/faults.py``; those on the virtual clock in tests/call.
"""

import asyncio
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pica_protocol.frames import Frame
from simnet.peers import peer_in_room
from simnet.relays import RelayProcess

pytestmark = pytest.mark.realtime

if os.name == "nt":
    pytest.skip("stops relays with Unix signals", allow_module_level=True)

RELAY = [sys.executable, "-m", "pica_command", "relay", "--avatar-store", "none", "--port"]


@contextmanager
def relay(
    *prefix: str, port: int = 0, folder: Path | None = None, **options: object
) -> Iterator[RelayProcess]:
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
        yield RelayProcess(process, url)
    finally:
        process.kill()
        process.communicate()


async def call_goes_on(url: str) -> None:
    async with peer_in_room(url, "Ada") as ada, peer_in_room(url, "Bob") as bob:
        await ada.send_frame(b"hello")
        assert (await bob.until(Frame)).payload == b"hello"


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
