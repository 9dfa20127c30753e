"""Sound in a process of its own, with devices of a library that stands in for the real one."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from pica_client.voice.opus import FRAME_S, FRAME_SAMPLES, MAX_LEVEL, OpusEncoder, available
from pica_client.voice.sound.process import SoundProcess
from pica_client.voice.sound.settings import SoundSettings
from pica_client.voice.source import shipped_speech
from pica_protocol.frames import Frame

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc"),
    pytest.mark.skipif(available() is not None, reason="no libopus"),
]

LIBRARY = """
import time
from pathlib import Path
import numpy as np

played = np.zeros(1)

class Device:
    latency = 0.02

    def __init__(self, name):
        self.name, self.channels = name, 1 if name == "Mono" else 2

    def player(self, *_, **__):
        self.until_s = time.monotonic()
        return self

    def wait(self, count):
        self.until_s = max(self.until_s + count / 48000, time.monotonic() - 0.04)
        time.sleep(max(self.until_s - time.monotonic(), 0.0))

    def play(self, sound):
        global played
        self.wait(len(sound))
        played = sound.mean(axis=1)

    def record(self, count):
        self.wait(count)
        return np.resize(played, (count, 1))

    recorder, __enter__, __exit__ = player, lambda self: self, lambda self, *_: None

def all_speakers():
    names = Path(__file__).with_name("speakers").read_text().split()
    return [Device(name) for name in names]

def all_microphones():
    return [Device("Monitor")]

def default_speaker():
    return all_speakers()[0]

def default_microphone():
    return all_microphones()[0]
"""
"""What the process imports as ``soundcard``: its loudspeakers stand in a file, the default one
first, and its microphone hears what is played."""


def until(holds: Callable[[], object], seconds: float = 8.0) -> bool:
    """Wait until something holds; whether it did in time."""
    until_s = time.monotonic() + seconds
    while not holds() and time.monotonic() < until_s:
        time.sleep(0.02)
    return bool(holds())


def say(sound: SoundProcess, seconds: float, peer_id: str = "ann") -> tuple[int, int]:
    """Play the sentences that ship, in real time; the loudest levels of loudspeaker
    and microphone meanwhile."""
    speech, speaker, microphone = shipped_speech(), MAX_LEVEL, MAX_LEVEL
    encoder, begin_s = OpusEncoder(24_000), time.monotonic()
    for index in range(round(seconds / FRAME_S)):
        places = np.arange(index * FRAME_SAMPLES, (index + 1) * FRAME_SAMPLES) % len(speech)
        opus = encoder.encode(speech[places])
        now = time.monotonic()
        if opus is not None:
            captured_us = round((begin_s + index * FRAME_S) * 1e6)
            frame = Frame(stream=1, sequence=index, captured_us=captured_us, payload=opus)
            sound.receive(peer_id, frame, now)
        time.sleep(max(begin_s + (index + 1) * FRAME_S - time.monotonic(), 0.0))
        speaker = min(speaker, sound.state.speaker_level)
        microphone = min(microphone, sound.state.microphone_level)
    return speaker, microphone


@pytest.fixture(scope="module")
def speakers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file with the names of those that are plugged in."""
    path = tmp_path_factory.mktemp("library") / "speakers"
    path.write_text("Speaker Mono")
    path.with_name("soundcard.py").write_text(LIBRARY)
    return path


@pytest.fixture(scope="module")
def sound(speakers: Path) -> Iterator[SoundProcess]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(speakers.parent))
        process = SoundProcess()
        process.follow(SoundSettings())
        assert until(lambda: process.state.speaker.name == "Speaker")
        yield process
        process.close()


def workers() -> list[int]:
    """The processes of ours that sound lives in."""
    children = Path("/proc/self/task").glob("*/children")
    pids = {int(pid) for each in children for pid in each.read_text().split()}
    return [p for p in pids if b"sound.worker" in Path(f"/proc/{p}/cmdline").read_bytes()]


def test_another_loudspeaker_takes_over_and_one_unplugged_is_replaced(
    sound: SoundProcess, speakers: Path
) -> None:
    leaves_s: list[float] = []
    sound.hand_mix_to(lambda mix, at_s: leaves_s.append(at_s))
    sound.follow(SoundSettings(speaker="Mono"))
    assert until(lambda: sound.state.speaker.name == "Mono")
    assert until(lambda: len(leaves_s) > 20)
    assert np.mean(np.diff(leaves_s)) == pytest.approx(0.02, abs=0.004)
    speakers.write_text("Speaker")
    assert until(lambda: sound.state.speaker.name == "Speaker")
    assert "no loudspeaker 'Mono'" in sound.state.trouble
    speakers.write_text("Speaker Mono")
    assert until(lambda: sound.state.speaker.name == "Mono")
    assert sound.state.trouble == ""


def test_what_is_said_is_heard_seen_on_meters_and_followed_by_faces(sound: SoundProcess) -> None:
    sound.follow(SoundSettings(cleans=False))
    sound.use_microphone(True)  # it hears the loudspeaker
    assert until(lambda: sound.state.microphone.name == "Monitor")
    sound.seat(["ann"])
    assert max(say(sound, 2.0)) < 40
    moment = sound.state.voices["ann"].moment
    assert moment is not None
    now = moment[0]
    heard_us = sound.heard_us("ann", now)
    assert heard_us is not None
    assert 0.0 < now - heard_us / 1e6 < 0.6
    sound.set_volumes({"ann": 0.0})
    say(sound, 0.5)
    assert min(say(sound, 0.5)) > 100
    sound.set_volumes({"ann": 1.0})
    assert min(say(sound, 0.5)) < 40
    assert set(sound.state.voices) == {"ann"}
    sound.use_microphone(False)


def test_sound_that_ends_by_itself_begins_again_as_it_was(sound: SoundProcess) -> None:
    sound.follow(SoundSettings(speaker="none"))
    assert until(lambda: sound.state.speaker.name == "none")
    (pid,) = workers()
    os.kill(pid, signal.SIGKILL)
    assert until(lambda: "begins again" in sound.state.trouble)
    assert until(lambda: sound.state.speaker.name == "none")
    sound.close()
    assert not workers()
