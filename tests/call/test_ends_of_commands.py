"""How commands end: in the time they were given, with their report and no traceback, whatever the
user, the disk or the reader of their output does."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from helpers.toy import make_toy_avatar
from pica_client.local_call.processes import Children
from pica_core.avatar.file import save_avatar

pytestmark = pytest.mark.call

NOBODY = "ws://127.0.0.1:9"
FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="needs a disk that is always full")


@pytest.fixture
def relay_url() -> Iterator[str]:
    with Children() as children:
        yield children.start_relay()[1]


@pytest.fixture
def send_words(tmp_path: Path) -> list[str]:
    path = tmp_path / "toy.pica"
    save_avatar(path, make_toy_avatar())
    return ["send", "--avatar", str(path), "--give-avatar", "no"]


def pica(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pica_command", *words, "--json"]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


def report_of(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    return dict(json.loads(done.stdout.splitlines()[-1]))


def test_who_waits_for_a_relay_ends_when_the_time_is_over(send_words: list[str]) -> None:
    for words in (send_words, ["view", "--headless"]):
        done = pica(*words, "--url", NOBODY, "--wait", "--seconds", "1")
        assert done.returncode == 2
        assert "no relay answers at ws://127.0.0.1:9 (tried for 1 s: " in done.stderr


@needs_full
def test_a_full_disk_costs_a_viewer_its_pictures_and_not_its_report(relay_url: str) -> None:
    files = ["--png", str(FULL), "--record", str(FULL)]
    words = ["--url", relay_url, "--headless", "--size", "64x48", "--seconds", "1"]
    done = pica("view", *words, *files)
    report = report_of(done)
    assert done.returncode == 1
    assert report["frames_rendered"] > 0
    assert report["ok"] is False
    assert report["problems"] == 2 * ["/dev/full: cannot be written: No space left on device"]
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("kind", ["send", "view"])
def test_a_second_interrupt_does_not_cost_the_report(
    kind: str, relay_url: str, send_words: list[str]
) -> None:
    words = send_words if kind == "send" else ["view", "--headless", "--size", "64x48"]
    with subprocess.Popen(
        [sys.executable, "-m", "pica_command", *words, "--url", relay_url, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        process.stderr.readline()  # it is in the room
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        time.sleep(0.02)  # signals of one kind that come together are one
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "reconnects" in said.splitlines()[-1]


@pytest.mark.parametrize("unread", ["stdout", "both"])
@pytest.mark.parametrize("words", ["--help", "avatar info amara --json"])
def test_output_that_nobody_reads_is_no_traceback(words: str, unread: str) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "pica_command", *words.split()],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE if unread == "stdout" else subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        process.stdout.close()
        said = "" if process.stderr is None else process.stderr.read()
        assert process.wait(60) in (1, 141)  # 1: rich ends by itself
    assert "Traceback" not in said
    assert "Exception ignored" not in said


@needs_full
@pytest.mark.parametrize("words", ["--help", "avatar info amara --json"])
def test_output_for_which_there_is_no_room_is_one_line(words: str) -> None:
    command = [sys.executable, "-m", "pica_command", *words.split()]
    with FULL.open("w") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert ended.returncode == 1
    assert "Traceback" not in ended.stderr
    last = "pica: the output cannot be written: No space left on device"
    assert ended.stderr.splitlines()[-1] == last
