"""A voice through the real parts: sender, relay, viewer and a loudspeaker of PulseAudio.

What leaves the loudspeaker is recorded and compared with what was said. Needs the extras voice and
bench, and PulseAudio. Wall-clock: run it on a quiet machine.

python scripts/voice_devices.py            a call
python scripts/voice_devices.py --echo     what of it comes back through a microphone
python scripts/voice_devices.py --busy     whether the mix comes in time beside drawing
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "client" / "voice" / "sound"))

from devices_trial import captured

from helpers.sound_server import sound_server
from helpers.sound_trial import echo_db
from pica_client.voice.mixer import VoiceMixer
from pica_client.voice.opus import OpusDecoder
from pica_client.voice.packet import SAMPLE_RATE_HZ
from pica_client.voice.sound.devices import Loudspeaker
from pica_client.voice.sound.process import SoundProcess
from pica_client.voice.sound.settings import SoundSettings
from pica_client.voice.wav import resampled, shipped_speech

PORT, SECONDS = 18799, 15
PICA = [sys.executable, "-m", "pica_command"]
SCORE_HZ = 16_000
CALL = ["--url", f"ws://127.0.0.1:{PORT}", "--room", "sound"]


def judged(heard: np.ndarray) -> dict[str, float]:
    """PESQ and STOI of the place that is most like the sentences."""
    from pesq import pesq
    from pystoi import stoi

    said = shipped_speech()
    said = said[: len(said) - SAMPLE_RATE_HZ // 5]
    size = 1 << 20
    spectrum = np.fft.rfft(heard, size) * np.fft.rfft(said, size).conj()
    begin = int(np.argmax(np.fft.irfft(spectrum)[: len(heard) - len(said)]))
    pair = [
        resampled(sound.astype(np.float32), SAMPLE_RATE_HZ, SCORE_HZ)
        for sound in (said, heard[begin : begin + len(said)])
    ]
    return {
        "pesq": round(float(pesq(SCORE_HZ, *pair, "wb")), 2),
        "stoi": round(float(stoi(*pair, SCORE_HZ)), 3),
    }


def echo() -> None:
    """Say how much softer the canceller makes what a microphone hears of the loudspeaker."""
    with (
        tempfile.TemporaryDirectory() as folder,
        sound_server(Path(folder)),
        closing(SoundProcess()) as sound,
    ):
        plain, cleaned = (echo_db(sound, SoundSettings(cleans=on)) for on in (False, True))
    found = {"heard_db": -plain, "cleaned_db": -cleaned, "echo_return_loss_db": cleaned - plain}
    print(json.dumps({name: round(value, 1) for name, value in found.items()}))


def busy() -> None:
    """Mix beside a thread that works as drawing does, in a process of its own and without one."""

    def work(seconds: float = 6.0) -> None:
        until_s, table = time.monotonic() + seconds, np.ones((400, 400))
        while time.monotonic() < until_s:
            for _ in range(3):
                table @ table  # lets others run
            sum(number * number for number in range(60_000))  # does not

    def told(times_s: list[float]) -> dict[str, float]:
        steps_ms = np.diff(times_s) * 1e3
        torn_ms = np.maximum(steps_ms - 60, 0)  # a loudspeaker keeps 40 ms, and takes 20
        return {
            "p99_ms": round(float(np.percentile(steps_ms, 99)), 1),
            "torn": int((torn_ms > 0).sum()),
            "torn_ms": round(float(torn_ms.sum())),
        }

    found = {}
    with tempfile.TemporaryDirectory() as folder, sound_server(Path(folder)):
        with closing(SoundProcess()) as sound:
            apart: list[float] = []
            sound.on_mixed = lambda mix, leaves_s: apart.append(leaves_s)
            sound.hand_on(True)
            time.sleep(3.5)
            apart.clear()
            work()
            found["own process"] = told(apart)
        loudspeaker, beside = Loudspeaker(VoiceMixer(OpusDecoder)), []
        loudspeaker.on_played = lambda mix: beside.append(time.monotonic())
        loudspeaker.start()
        time.sleep(3.5)
        beside.clear()
        work()
        found["one process"] = told(beside)
        loudspeaker.stop()
    print(json.dumps(found))


def main() -> None:
    """Hold the call, and print one JSON object."""
    with tempfile.TemporaryDirectory() as folder, sound_server(Path(folder)):
        quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        sender = ["--name", "Ann", "--source", "performance:talk", "--voice", "speech"]
        viewer = ["--name", "Bo", "--headless", "--size", "160x90", "--speaker", "Speaker"]
        viewer += ["--expect", "1", "--seconds", str(SECONDS), "--json"]
        relay = subprocess.Popen([*PICA, "relay", "--port", str(PORT)], **quiet)
        time.sleep(3)
        send = subprocess.Popen([*PICA, "send", *CALL, *sender], **quiet)
        try:
            view = subprocess.Popen(
                [*PICA, "view", *CALL, *viewer], stdout=subprocess.PIPE, text=True
            )
            time.sleep(6)
            heard, _, _ = asyncio.run(captured("", SECONDS - 1.0))
            answer = view.communicate(timeout=60)[0]
        finally:
            for process in (send, relay):
                process.terminate()
                process.wait(timeout=20)
    voice = json.loads(answer.splitlines()[-1])["voice"]
    print(json.dumps({**judged(heard), **voice}))


if __name__ == "__main__":
    {"--echo": echo, "--busy": busy}.get(sys.argv[-1], main)()
