"""A real NATS server with JetStream on a free loopback port, for tests of placement."""

import shutil
import socket
import subprocess
import time
from pathlib import Path

import pytest

PROGRAM = shutil.which("nats-server") or shutil.which("nats-server", path="/usr/sbin")
INSTALL = "install it with: sh scripts/system_libraries.sh --nats"

needs_nats = pytest.mark.skipif(PROGRAM is None, reason=f"nats-server is not here; {INSTALL}")


class NatsServer:
    """One server; what it stores outlives a restart.

    Attributes:
        url: Where it listens.
    """

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
