"""``pica relay`` as a process, on a machine without numpy, torch, ONNX Runtime and moderngl."""

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from helpers.certificates import write_certificate
from pica_protocol.frames import Frame
from pica_server.tokens import new_key_line
from simnet.peers import peer_in_room

pytestmark = pytest.mark.call

if os.name == "nt":
    pytest.skip("stops the relay with Unix signals", allow_module_level=True)

# Makes the heavy packages look absent, then runs the installed command.
PROGRAM = """
import sys

ABSENT = {"numpy", "torch", "onnxruntime", "onnx", "moderngl", "pica_core", "pica_client"}

sys.modules |= dict.fromkeys(ABSENT)
from pica_command.main import main

code = main()
assert not any(map(sys.modules.get, ABSENT)), ABSENT & set(sys.modules)
sys.exit(code)
"""


def start(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "relay", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@contextmanager
def running_relay(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    process = start("--port", "0", *arguments)
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        assert line.startswith("listening on ws://127.0.0.1:"), line + process.stderr.read()
        yield process, line.split()[-1]
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.mark.parametrize(
    "module", ["pica_command.options", "pica_server.cli.relay", "uvloop", "pica_server.relay"]
)
def test_a_signal_while_the_relay_is_loaded_ends_it_in_good_order(module: str) -> None:
    early = f"""
import os, signal, sys

class Early:
    def find_spec(self, name, path=None, target=None):
        if name == "{module}":
            os.kill(os.getpid(), signal.SIGTERM)

sys.meta_path.insert(0, Early())
"""
    ended = subprocess.run([sys.executable, "-c", early + PROGRAM, "relay", "--port", "0"])
    assert ended.returncode == 0


@pytest.mark.parametrize("name", [signal.SIGTERM, signal.SIGINT])
def test_a_relay_without_numpy_forwards_stops_on_a_signal_and_prints_its_numbers(
    name: signal.Signals, tmp_path: Path
) -> None:
    async def call(url: str) -> None:
        async with peer_in_room(url, "Ada") as ada, peer_in_room(url, "Bob") as bob:
            await ada.send_frame(b"hello")
            assert (await bob.until(Frame)).payload == b"hello"

    ready_file = tmp_path / "ready"
    with running_relay("--json", "--ready-file", str(ready_file)) as (process, url):
        assert ready_file.read_text() == f"{url}\n"
        asyncio.run(call(url))
        process.send_signal(name)
        stdout, stderr = process.communicate(timeout=30)
    assert process.returncode == 0, stderr
    stats = json.loads(stdout.splitlines()[-1])
    assert (stats["frames_in"], stats["frames_out"]) == (1, 1)
    size = stats["bytes_out"]
    summary = f"forwarded 1 frames ({size} bytes) for 2 joins; 0 frames dropped"
    assert stderr.splitlines()[-1] == summary
    assert not ready_file.exists()


def test_signals_that_repeat_cost_no_numbers() -> None:
    with running_relay("--json") as (process, _):
        for _ in range(50):
            process.send_signal(signal.SIGTERM)
            time.sleep(0.002)
        stdout, stderr = process.communicate(timeout=30)
    assert process.returncode == 0, stderr
    assert json.loads(stdout.splitlines()[-1])["open_connections"] == 0


@pytest.mark.parametrize("tls", [False, True])
def test_with_few_descriptors_it_goes_on(tls: bool, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "pica_command", "relay", "--port", "0", "--avatar-store", "none"]
    if tls:  # another event loop
        path = write_certificate(tmp_path)
        words += ["--tls-cert", str(path), "--tls-key", str(path.with_suffix(".key"))]
    relay = subprocess.Popen(
        ["sh", "-c", 'ulimit -n 64; exec "$@"', "sh", *words], stderr=subprocess.PIPE, text=True
    )
    assert relay.stderr is not None
    port = int(relay.stderr.readline().rpartition(":")[2])
    with ExitStack() as sockets:
        for _ in range(100):
            sockets.enter_context(socket.create_connection(("127.0.0.1", port), 1))
        time.sleep(0.5)
    time.sleep(1.5)  # asyncio waits for a second before it accepts again
    with socket.create_connection(("127.0.0.1", port), 5) as late:
        if not tls:
            late.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
            assert late.recv(100).startswith(b"HTTP/1.1 200")
    relay.terminate()
    relay.communicate(timeout=30)
    assert relay.returncode == 0


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--port", "70000"], "pica relay: --port must be in 0..65535, got 70000"),
        (["--host", "127.0.0.1", "--port", "BUSY"], "choose another --port"),
        (["--port", "0", "--ready-file", "/nowhere/at/all"], "cannot write --ready-file"),
    ],
)
def test_what_cannot_work_ends_in_one_line_and_exit_code_two(
    arguments: list[str], complaint: str
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as busy:
        port = str(busy.getsockname()[1])
        process = start(*(port if argument == "BUSY" else argument for argument in arguments))
        _, stderr = process.communicate(timeout=30)
    assert process.returncode == 2, stderr
    (line,) = stderr.splitlines()
    assert complaint in line


@pytest.mark.parametrize(
    ("options", "words"),
    [("--host 0.0.0.0 --insecure", "INSECURE: "), ("--keys {keys}", "anybody on this machine can")],
)
def test_an_open_relay_says_loudly_that_it_is_open(
    options: str, words: str, tmp_path: Path
) -> None:
    (keys := tmp_path / "keys").write_text(new_key_line())
    keys.chmod(0o644)
    process = start("--port", "0", *options.format(keys=keys).split())
    assert process.stderr is not None
    process.stderr.readline()
    process.send_signal(signal.SIGTERM)
    assert process.stderr.read().startswith(words)
    process.communicate(timeout=30)
    assert process.returncode == 0


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

    with running_relay("--drain-s", "600") as (process, url):
        start = time.monotonic()
        asyncio.run(stubborn(process, url))
        assert process.returncode == 0
        assert time.monotonic() - start < 60  # of the 600 that it might have taken
