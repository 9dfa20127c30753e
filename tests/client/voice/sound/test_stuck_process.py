"""Sound whose process stands still, or ends by itself."""

import os
import sys
import threading
from pathlib import Path

import pytest

from pica_client.voice.sound.process import SoundProcess

pytestmark = [
    pytest.mark.unit,
    pytest.mark.skipif(sys.platform == "win32", reason="a shell script stands in for it"),
]


def test_sound_that_reads_nothing_any_more_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stuck, begun = tmp_path / "stuck", tmp_path / "begun"
    os.mkfifo(begun)
    stuck.write_text(f"#!/bin/sh\necho $$ > {begun}\nexec sleep 600\n")
    stuck.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(stuck))
    sound = SoundProcess()
    sound.set_volumes({f"peer {index}": 1.0 for index in range(100_000)})  # more than a pipe holds
    pid = int(begun.read_text())
    closing = threading.Thread(target=sound.close, daemon=True)
    closing.start()
    closing.join(timeout=30)
    assert not closing.is_alive()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_sound_that_begins_again_leaves_no_thread_of_the_process_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    brief, begun = tmp_path / "brief", tmp_path / "begun"
    os.mkfifo(begun)
    brief.write_text(f"#!/bin/sh\necho > {begun}\n")
    brief.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(brief))
    monkeypatch.setattr("pica_client.voice.sound.process.RESTART_S", 0.0)
    sound = SoundProcess()
    sound.set_volumes({})
    assert begun.read_text()
    assert begun.read_text()
    # Whoever would begin it a third time waits here until it is closed.
    sound.close()
    for thread in threading.enumerate():
        if thread.name == "sound":
            thread.join(timeout=30)
    assert "sound-outbox" not in [thread.name for thread in threading.enumerate()]
