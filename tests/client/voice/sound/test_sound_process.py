"""A process of sound that stands still, ends by itself, or tells of a microphone."""

import asyncio
import os
import pickle
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from pica_client.voice.opus import FRAME_SAMPLES
from pica_client.voice.sound.process import WIDTH_RAD, SoundProcess
from pica_client.voice.sound.settings import DeviceState, SoundState
from pica_client.voice.source import open_voice
from pica_command.main import main

pytestmark = [
    pytest.mark.unit,
    pytest.mark.skipif(sys.platform == "win32", reason="a shell script stands in for it"),
]


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Let a shell script be the process; gives a pipe that it may write to."""
    program, pipe = tmp_path / "program", tmp_path / "pipe"
    os.mkfifo(pipe)

    def write(script: str) -> Path:
        program.write_text(f"#!/bin/sh\n{script}\n".replace("PIPE", str(pipe)))
        program.chmod(0o700)
        monkeypatch.setattr(sys, "executable", str(program))
        return pipe

    return write


@pytest.mark.slow
def test_sound_that_reads_nothing_any_more_is_ended(stand_in: Callable[[str], Path]) -> None:
    begun = stand_in("echo $$ > PIPE\nexec sleep 600")
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
    stand_in: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = stand_in("echo > PIPE")
    monkeypatch.setattr("pica_client.voice.sound.process.RESTART_S", 0.0)
    sound = SoundProcess()
    sound.set_volumes({})
    assert begun.read_text()
    assert begun.read_text()
    # A third start waits here until it is closed.
    sound.close()
    for thread in threading.enumerate():
        if thread.name == "sound":
            thread.join(timeout=30)
    assert "sound-outbox" not in [thread.name for thread in threading.enumerate()]


def test_voices_come_from_places_in_the_order_of_coming(
    stand_in: Callable[[str], Path], tmp_path: Path
) -> None:
    stand_in(f"cat > {tmp_path / 'told'}")
    sound = SoundProcess()
    for peer_ids in ([], ["ada", "ben"], ["ada", "ben"], ["ada", "ben", "cho"], ["cho"]):
        sound.seat(peer_ids)
    sound.close()
    seats = []
    with (tmp_path / "told").open("rb") as told, suppress(EOFError):
        while True:
            name, (said, *_) = pickle.load(told)
            seats += [said] if name == "seat" else []
    left, right = -WIDTH_RAD, WIDTH_RAD
    two, three = {"ada": left, "ben": right}, {"ada": left, "ben": 0.0, "cho": right}
    assert seats == [two, two, three, {"cho": 0.0}]  # at first as what lasts, too


def test_a_sender_hears_its_microphone_and_is_told_what_is_wrong_with_it(
    stand_in: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    monkeypatch.setattr("pica_client.voice.source.find_spec", lambda name: True)
    monkeypatch.setattr("pica_client.voice.source.say", said.append)
    pcm = np.zeros(FRAME_SAMPLES, np.float32)
    missing = SoundState(microphone=DeviceState(note="no microphone on this machine"))
    told = (missing, missing, SoundState(), ("captured", pcm, 1_234_567))
    (tmp_path / "told").write_bytes(b"".join(map(pickle.dumps, told)))
    stand_in(f"cat {tmp_path / 'told'}\ncat > /dev/null")

    async def hear() -> int:
        microphone = open_voice("mic:Desk")
        assert microphone is not None
        stopping = asyncio.Event()
        async for _, captured_us in microphone.frames(stopping):
            stopping.set()
            found = captured_us
        microphone.close()
        return found

    assert asyncio.run(hear()) == 1_234_567
    assert said == ["no microphone on this machine", "the microphone is there again"]


def test_a_sender_without_the_extra_is_told_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "soundcard", None)
    assert main(["send", "--voice", "mic"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("pica send: needs soundcard; install it with: pip install")
