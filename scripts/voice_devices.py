"""A voice through the real parts: sender, relay, viewer and a loudspeaker of PulseAudio.

What leaves the loudspeaker is recorded and compared with what was said. Needs the extras voice and
bench, and PulseAudio. Wall-clock: run it on a quiet machine.

python scripts/voice_devices.py
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "client" / "voice" / "sound"))

from devices_trial import captured

from helpers.sound_server import sound_server
from pica_client.voice.packet import SAMPLE_RATE_HZ
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


def main() -> None:
    """Hold the call, and print one JSON object."""
    with tempfile.TemporaryDirectory() as folder, sound_server(Path(folder)):
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
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
    main()
