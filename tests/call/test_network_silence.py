"""A call looks up and connects to nothing but loopback, and the check can see it when one does.

Each command runs in a network namespace of its own in which only loopback has a route. The kernel
counts what has none, whether Python or a native library asks for it, a name server included. Not
seen: what goes through a unix socket to a daemon of the machine.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pytest

ISOLATED = ["unshare", "-rn", "sh", "-c", 'ip link set lo up && "$@" >&2 && cat /proc/net/snmp*']
CAN_ISOLATE = all(map(shutil.which, ("unshare", "ip"))) and (
    subprocess.run([*ISOLATED, "sh", "true"], capture_output=True, check=False).returncode == 0
)
pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(not CAN_ISOLATE, reason="needs Linux, ip, and unshare that is permitted"),
]

SECONDS = 10
"""How long a receiver runs: ONNX Runtime's first upload was seen 6 to 9 s after its import."""
DEVICE_ID = ".cache/Microsoft/DeveloperTools/.onnxruntime"
"""Where ONNX Runtime keeps its identifier of a machine, below the home folder, on Linux."""

RELAY_SEND_VIEW = f"""
import signal, subprocess, sys, time
from pica_client.local_call.processes import Children
pica = [sys.executable, "-m", "pica_command"]
with Children() as children:
    relay, url = children.start_relay()
    sender = subprocess.Popen([*pica, "send", "--url", url, "--name", "Ada"])
    subprocess.run(
        [*pica, "view", "--url", url, "--name", "me", "--headless", "--size", "160x90",
         "--seconds", "{SECONDS}", "--expect", "1", "--png", "seen.png"], check=True)
    sender.send_signal(signal.SIGINT)
    assert sender.wait(20) == 0
"""
TELEMETRY_ON = f"""
import os, time
os.environ["ORT_DISABLE_TELEMETRY"] = "0"
from pica_client.decode.decoder import onnxruntime
time.sleep({SECONDS})
"""

PYTHON_ASKS = """
import contextlib, socket
for host in ("127.0.0.1", "198.51.100.7", "somewhere.example"):
    with contextlib.suppress(OSError):
        socket.create_connection((host, 443), 2)
with contextlib.suppress(OSError):
    socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b"x", ("203.0.113.9", 5353))
"""


def attempts(script: str, home: Path) -> int:
    """Run a script at home; how often it tried to reach what is not loopback.

    Datagrams to a port of loopback that is not open count, too: a name server may be meant there.
    """
    environment = {key: value for key, value in os.environ.items() if not key.startswith("XDG_")}
    environment.pop("ORT_DISABLE_TELEMETRY", None)
    done = subprocess.run(
        [*ISOLATED, "sh", sys.executable, "-c", script],
        cwd=home,
        env={**environment, "HOME": str(home)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return sum(_counts(done.stdout.splitlines(), name) for name in ("OutNoRoutes", "NoPorts"))


def _counts(lines: Sequence[str], name: str) -> int:
    """Sum a counter of both versions of IP."""
    rows = [line.split() for line in lines]
    found = [int(row[1]) for row in rows if row[0] in (f"Ip6{name}", f"Udp6{name}")]
    found += [
        int(values[heads.index(name)])
        for heads, values in pairwise(rows)
        if heads[0] == values[0] and name in heads
    ]
    return sum(found)


def test_relay_send_and_view_reach_for_nothing_beyond_loopback(tmp_path: Path) -> None:
    assert attempts(RELAY_SEND_VIEW, tmp_path) == 0
    assert (tmp_path / "seen.png").exists()
    assert not (tmp_path / DEVICE_ID).exists()


def test_a_user_who_leaves_the_telemetry_on_is_obeyed_and_the_check_sees_it(tmp_path: Path) -> None:
    tried = attempts(TELEMETRY_ON, tmp_path)
    if not (tmp_path / DEVICE_ID).exists():
        pytest.skip("this build of ONNX Runtime has no telemetry")
    assert tried > 0


def test_the_check_sees_look_ups_connections_and_datagrams_of_python(tmp_path: Path) -> None:
    assert attempts(PYTHON_ASKS, tmp_path) >= 3
