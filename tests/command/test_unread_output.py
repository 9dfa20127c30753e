"""A command whose output has no reader any more, as after ``| head``, or for which there is no
room, ends without a traceback."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.call


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


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no full device")
@pytest.mark.parametrize("words", ["--help", "avatar info amara --json"])
def test_output_for_which_there_is_no_room_is_one_line(words: str) -> None:
    command = [sys.executable, "-m", "pica_command", *words.split()]
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert ended.returncode == 1
    assert "Traceback" not in ended.stderr
    last = "pica: the output cannot be written: No space left on device"
    assert ended.stderr.splitlines()[-1] == last
