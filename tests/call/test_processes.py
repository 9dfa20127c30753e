"""Whole processes on a real clock: nothing hangs, everybody comes back, bad input ends with 2."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from helpers.toy import make_toy_avatar
from pica_client.avatars.library import AvatarLibrary
from pica_client.bench.call import BenchConfig, bench_call
from pica_client.errors import CallProcessError
from pica_client.local_call.local_call import LocalCall, LocalCallConfig
from pica_client.local_call.processes import Children
from pica_client.voice.sound.process import SoundProcess
from pica_core.avatar.file import save_avatar

pytestmark = pytest.mark.call

PATIENCE_S = 30.0
"""Nothing here should take this long; a loaded machine may."""
POLL_S = 0.02
TOY = make_toy_avatar()


@pytest.fixture
def avatar_file(tmp_path: Path) -> Path:
    path = tmp_path / "toy.pica"
    save_avatar(path, TOY)
    return path


@pytest.fixture
def children() -> Iterator[Children]:
    with Children() as group:
        yield group


def wait_until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"{what}: not within {PATIENCE_S} s"
        time.sleep(POLL_S)


def is_running(pid: int) -> bool:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_processes_end_with_a_parent_that_was_killed(avatar_file: Path, tmp_path: Path) -> None:
    script = (
        "import sys, time\n"
        "from pica_client.local_call.processes import Children\n"
        "with Children() as children:\n"
        "    relay, url = children.start_relay()\n"
        "    sender = children.start('sender', 'send', '--url', url, '--avatar', sys.argv[1])\n"
        "    print(relay.pid, sender.pid, flush=True)\n"
        "    time.sleep(600)\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", script, str(avatar_file)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(tmp_path)},  # a killed parent leaves its folder behind
    )
    assert parent.stdout is not None
    pids = [int(pid) for pid in parent.stdout.readline().split()]
    assert [is_running(pid) for pid in pids] == [True, True]
    parent.kill()
    parent.wait()
    parent.stdout.close()
    wait_until(lambda: not any(is_running(pid) for pid in pids), "children end")


def test_no_process_of_ours_runs_a_module_that_lies_in_the_current_folder(
    children: Children, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("pickle.py", "random.py"):
        Path(name).write_text("open('was-run', 'w')\nfrom not_ours import everything\n")
    children.start_relay()
    sound = SoundProcess()
    sound.set_volumes({})
    sound.close()
    assert not Path("was-run").exists()


def test_a_killed_sender_is_reported_by_name(children: Children, avatar_file: Path) -> None:
    library = AvatarLibrary(shipped=[avatar_file])
    stage = LocalCall(LocalCallConfig(peers=2, avatar=str(avatar_file)), library, children)
    os.kill(stage.senders["Ben"].pid, signal.SIGKILL)
    wait_until(lambda: stage.senders["Ben"].exit_code is not None, "Ben ends")
    with pytest.raises(CallProcessError, match="sender Ben was killed by signal 9") as raised:
        stage.check()
    assert raised.value.exit_code == 1
    library.close()


def test_bad_input_of_a_part_is_bad_input_of_the_whole(children: Children) -> None:
    viewer = children.start("viewer", "view", "--size", "big")
    wait_until(lambda: viewer.exit_code is not None, "the viewer ends")
    with pytest.raises(CallProcessError, match="size is 'big'") as raised:
        viewer.result()
    assert raised.value.exit_code == 2


def test_a_short_bench_decodes_every_peer_without_errors(avatar_file: Path) -> None:
    stage = LocalCallConfig(peers=2, avatar=str(avatar_file))
    result = bench_call(BenchConfig(call=stage, seconds=1.5))
    json.dumps(result)
    assert (result["peers"], result["decoded_peers"], result["errors"]) == (2, 2, 0)
    assert set(result["bitrate_bps"]["Ada"]) == {"payload", "wire"}
    assert result["latency_ms"]["p50"] > result["without_playout_ms"]["p50"] > 0
