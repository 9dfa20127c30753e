"""A real NATS server with JetStream on a free loopback port, for tests of a cluster."""

import shutil
import signal
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

    def __init__(self, folder: Path, *, jetstream: bool = True, config: Path | None = None) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.url = f"nats://127.0.0.1:{self.port}"
        self._folder = folder
        self._config = config
        self._jetstream = jetstream
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start, or start again, and wait until it listens."""
        assert PROGRAM is not None
        words = [PROGRAM, "-a", "127.0.0.1", "-p", str(self.port)]
        if self._jetstream:
            words += ["-js", "-sd", str(self._folder)]
        if self._config is not None:
            self._config.touch()
            words += ["-c", str(self._config)]
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

    def restart_if_ended(self) -> bool:
        """Start it again if it ended by itself, as what watches over services does; say whether it
        had."""
        has_ended = self._process is not None and self._process.poll() is not None
        if has_ended:
            self.start()
        return has_ended

    def freeze(self) -> None:
        """Stop it without ending it."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on."""
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)

    def ask_for_password(self, password: str) -> None:
        """Let nobody in without this password from now on, and send away who is in. Only with a
        server made with ``config``."""
        assert self._process is not None
        assert self._config is not None
        self._config.write_text(f'authorization {{ token: "{password}" }}')
        self._process.send_signal(signal.SIGHUP)

    def let_everybody_in(self) -> None:
        """Ask for no password when it starts again: Debian's 2.9 loses JetStream if told at
        once."""
        assert self._config is not None
        self._config.write_text("")

    def stop(self) -> None:
        """Kill it."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
