"""Sound in a process of its own, with devices that exist nowhere."""

import importlib.util
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
    pytest.mark.skipif(
        shutil.which("pulseaudio") is None, reason="no PulseAudio here: apt-get install pulseaudio"
    ),
    pytest.mark.skipif(importlib.util.find_spec("soundcard") is None, reason="no extra voice"),
    pytest.mark.skipif(available() is not None, reason="no libopus"),
]
START_S = 10.0
OTHER = "sink_properties=device.description=Mono44k"


def unload(sink: str) -> None:
    """Unplug a loudspeaker."""
    for line in pactl("list", "short", "modules").splitlines():
        if f"sink_name={sink} " in line + " ":
            pactl("unload-module", line.split()[0])


def pactl(*words: str) -> str:
    """Tell the server something; its answer."""
    done = subprocess.run(["pactl", *words], capture_output=True, text=True, timeout=10, check=True)
    return done.stdout.strip()


@contextmanager
def sound_server(folder: Path) -> Iterator[None]:
    """Run a server with two loudspeakers: "Speaker", whose sound the microphone hears, and
    "Mono44k", which is what its name says."""
    folder.chmod(0o700)
    modules = (
        f"module-native-protocol-unix socket={folder}/native",
        "module-null-sink sink_name=spk rate=48000 sink_properties=device.description=Speaker",
        "module-null-sink sink_name=old rate=44100 channels=1"
        " sink_properties=device.description=Mono44k",
    )
    patch = pytest.MonkeyPatch()
    for name in ("HOME", "XDG_RUNTIME_DIR", "PULSE_RUNTIME_PATH"):
        patch.setenv(name, str(folder))
    patch.setenv("PULSE_SERVER", f"unix:{folder}/native")
    server = subprocess.Popen(
        ["pulseaudio", "-n", "--daemonize=no", "--exit-idle-time=-1", "--use-pid-file=no"]
        + [f"--load={module}" for module in modules],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        until_s = time.monotonic() + START_S
        while True:
            try:
                pactl("set-default-sink", "spk")
                pactl("set-default-source", "spk.monitor")
                break
            except subprocess.SubprocessError:
                if time.monotonic() > until_s:
                    raise
                time.sleep(0.1)
        yield
    finally:
        server.terminate()
        server.wait(timeout=10)
        patch.undo()


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
def sound(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SoundProcess]:
    with sound_server(tmp_path_factory.mktemp("sound")):
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


def test_another_loudspeaker_takes_over_and_one_unplugged_is_replaced(sound: SoundProcess) -> None:
    leaves_s: list[float] = []
    sound.hand_mix_to(lambda mix, at_s: leaves_s.append(at_s))
    sound.follow(SoundSettings(speaker="Mono44k"))
    assert until(lambda: sound.state.speaker.name == "Mono44k")
    assert until(lambda: len(leaves_s) > 20)
    assert np.mean(np.diff(leaves_s)) == pytest.approx(0.02, abs=0.004)
    unload("old")
    assert until(lambda: sound.state.speaker.name == "Speaker")
    assert "no loudspeaker 'Mono44k'" in sound.state.trouble
    pactl("load-module", "module-null-sink", "sink_name=old", OTHER)
    assert until(lambda: sound.state.speaker.name == "Mono44k")
    assert sound.state.trouble == ""


def test_what_is_said_is_heard_seen_on_meters_and_followed_by_faces(sound: SoundProcess) -> None:
    sound.follow(SoundSettings(cleans=False))
    sound.use_microphone(True)  # it hears the loudspeaker
    assert until(lambda: sound.state.microphone.name == "Monitor of Speaker")
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
