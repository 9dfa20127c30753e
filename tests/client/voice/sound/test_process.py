"""Sound in a process of its own, with devices that exist nowhere."""

import importlib.util
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from helpers.sound_server import is_missing, pactl, sound_server, unload
from helpers.sound_trial import echo_db, say, until
from pica_client.voice.opus import available
from pica_client.voice.sound.process import SoundProcess
from pica_client.voice.sound.settings import SoundSettings

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(is_missing(), reason="no PulseAudio here: apt-get install pulseaudio"),
    pytest.mark.skipif(importlib.util.find_spec("soundcard") is None, reason="no extra voice"),
    pytest.mark.skipif(available() is not None, reason="no libopus"),
]
OTHER = "sink_properties=device.description=Mono44k"


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


def test_another_loudspeaker_takes_over_and_one_unplugged_is_replaced(
    sound: SoundProcess,
) -> None:
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
    sound.seat({"ann": 0.0})
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
    sound.play_test()
    assert until(lambda: sound.state.microphone_level < 40)
    assert set(sound.state.voices) == {"ann"}
    sound.use_microphone(False)


def test_what_others_say_is_taken_out_of_the_microphone(sound: SoundProcess) -> None:
    pytest.importorskip("livekit", reason="extra echo")
    plain = echo_db(sound, SoundSettings(cleans=False), 2.0)
    cleaned = echo_db(sound, SoundSettings(cleans=True), 4.0)
    assert cleaned - plain > 15


def test_sound_that_ends_by_itself_begins_again_as_it_was(sound: SoundProcess) -> None:
    sound.follow(SoundSettings(speaker="none"))
    assert until(lambda: sound.state.speaker.name == "none")
    (pid,) = workers()
    os.kill(pid, signal.SIGKILL)
    assert until(lambda: "begins again" in sound.state.trouble)
    assert until(lambda: sound.state.speaker.name == "none")
    sound.close()
    assert not workers()
