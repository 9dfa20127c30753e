"""A call looks up and connects to nothing but loopback, and the check can see it when one does."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest

from helpers.network_watch import reason_not_to_watch, watch

REASON = reason_not_to_watch()
pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(REASON is not None, reason=REASON or "watched"),
]

SECONDS = 10
"""How long a receiver runs: ONNX Runtime's first upload was seen 6 to 9 s after its import."""
PICA = [sys.executable, "-m", "pica_command"]
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

COMMANDS = {
    "relay, send, view": [sys.executable, "-c", RELAY_SEND_VIEW],
    "telemetry on": [sys.executable, "-c", TELEMETRY_ON],
}


@dataclass(frozen=True, slots=True)
class Watched:
    """What a command left behind."""

    home: Path
    seen: list[str]
    """Look-ups, connections and datagrams beyond loopback."""


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Watched]:
    """All commands, run at the same time, each in a network of its own."""
    homes = {name: tmp_path_factory.mktemp("home") for name in COMMANDS}
    with ThreadPoolExecutor(len(COMMANDS)) as pool:
        seen = pool.map(lambda name: watch(COMMANDS[name], home=homes[name]), COMMANDS)
        return {name: Watched(homes[name], each) for name, each in zip(COMMANDS, seen, strict=True)}


def test_relay_send_and_view_reach_for_nothing_beyond_loopback(
    watched: dict[str, Watched],
) -> None:
    call = watched["relay, send, view"]
    assert call.seen == []
    assert (call.home / "seen.png").exists()
    assert not (call.home / DEVICE_ID).exists()


def test_a_user_who_leaves_the_telemetry_on_is_obeyed_and_the_watch_sees_it(
    watched: dict[str, Watched],
) -> None:
    native = watched["telemetry on"]
    if not (native.home / DEVICE_ID).exists():
        pytest.skip("this build of ONNX Runtime has no telemetry")
    assert any(each.startswith("look-up ") for each in native.seen), native.seen


def test_the_watch_sees_the_look_ups_and_connections_of_python(tmp_path: Path) -> None:
    script = (
        "import contextlib, socket\n"
        "for host in ('127.0.0.1', '198.51.100.7', '2001:db8::7', 'somewhere.example'):\n"
        "    with contextlib.suppress(OSError):\n"
        "        socket.create_connection((host, 443), 2)\n"
        "socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b'x', ('203.0.113.9', 5353))\n"
    )
    seen = watch([sys.executable, "-c", script], home=tmp_path)
    assert [each for each in seen if "2001:db8::7" not in each] == [
        "tcp 198.51.100.7:443",
        "look-up somewhere.example",
        "udp 203.0.113.9:5353",
    ]
    assert ("tcp 2001:db8::7:443" in seen) == Path("/proc/net/if_inet6").exists()
