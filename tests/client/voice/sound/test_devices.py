"""Real streams through a real sound server, whose devices exist nowhere."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.sound_server import is_missing, sound_server
from pica_client.voice.opus import available

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(is_missing(), reason="no PulseAudio here: apt-get install pulseaudio"),
    pytest.mark.skipif(importlib.util.find_spec("soundcard") is None, reason="no extra voice"),
    pytest.mark.skipif(available() is not None, reason="no libopus"),
]
TRIAL = Path(__file__).with_name("devices_trial.py")


def test_what_is_played_is_heard_and_a_call_outlives_its_loudspeakers(tmp_path: Path):
    with sound_server(tmp_path):
        done = subprocess.run(
            [sys.executable, str(TRIAL)], capture_output=True, text=True, timeout=90, check=True
        )
    said = json.loads(done.stdout.splitlines()[-1])

    assert set(said["speakers"]) == {"Speaker", "Mono44k"}
    assert said["captured_from"] == "Monitor of Speaker"
    assert said["likeness"] > 0.99
    assert 10_000 <= said["steps_us"][0] <= 20_000 <= said["steps_us"][1] <= 30_000
    assert said["playing"] == "Speaker"
    assert 0 < said["latency_s"] < 0.3
    assert said["unplugged"]
    assert said["plugged"]


def test_without_a_sound_system_the_call_is_told_so(tmp_path: Path):
    code = """
import time
from pica_client.voice.sound.devices import Loudspeaker
from pica_client.voice.mixer import VoiceMixer
from pica_client.voice.opus import OpusDecoder
loudspeaker = Loudspeaker(VoiceMixer(OpusDecoder))
loudspeaker.start()
time.sleep(2.0)
print(loudspeaker.state.note)
loudspeaker.stop()
"""
    script = tmp_path / "alone.py"
    script.write_text(code)
    nowhere = {"PULSE_SERVER": f"unix:{tmp_path}/none", "PATH": "/usr/bin", "HOME": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, timeout=60, env=nowhere
    )
    assert "no sound system" in done.stdout, done.stderr[-2000:]
