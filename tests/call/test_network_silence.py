"""A call looks up and connects to nothing but loopback, and the check can see it when one does.

Each command runs in a network namespace of its own in which only loopback has a route. The kernel
counts what has none, whether Python or a native library asks for it, a name server included. Not
seen: what goes through a unix socket to a daemon of the machine.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import pytest

ISOLATED = ["unshare", "-rn", "sh", "-c", 'ip link set lo up && "$@" >&2 && cat /proc/net/snmp*']
CAN_ISOLATE = all(map(shutil.which, ("unshare", "ip"))) and (
    subprocess.run([*ISOLATED, "sh", "true"], capture_output=True, check=False).returncode == 0
)
pytestmark = [
    pytest.mark.call,
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


@pytest.fixture(scope="module")
def tried(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, Path]]:
    """What each script tried, and where its home is; they wait side by side."""
    scripts = {"call": RELAY_SEND_VIEW, "telemetry": TELEMETRY_ON, "python": PYTHON_ASKS}
    homes = [tmp_path_factory.mktemp(name) for name in scripts]
    with ThreadPoolExecutor() as pool:
        counts = pool.map(attempts, scripts.values(), homes)
        return dict(zip(scripts, zip(counts, homes, strict=True), strict=True))


def test_relay_send_and_view_reach_for_nothing_beyond_loopback(
    tried: dict[str, tuple[int, Path]],
) -> None:
    count, home = tried["call"]
    assert count == 0
    assert (home / "seen.png").exists()
    assert not (home / DEVICE_ID).exists()


def test_a_user_who_leaves_the_telemetry_on_is_obeyed_and_the_check_sees_it(
    tried: dict[str, tuple[int, Path]],
) -> None:
    count, home = tried["telemetry"]
    if not (home / DEVICE_ID).exists():
        pytest.skip("this build of ONNX Runtime has no telemetry")
    assert count > 0


def test_the_check_sees_look_ups_connections_and_datagrams_of_python(
    tried: dict[str, tuple[int, Path]],
) -> None:
    assert tried["python"][0] >= 3
