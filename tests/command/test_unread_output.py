"""A command whose output nobody reads any more, as after ``| head``, ends without a traceback."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize("unread", ["stdout", "both"])
@pytest.mark.parametrize("words", ["--help", "send --help", "doctor --json"])
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
