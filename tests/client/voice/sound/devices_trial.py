"""What `test_devices` does in a process of its own: SoundCard connects once, and for good.

Prints one JSON object.
"""

import asyncio
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))

from helpers.sound_server import pactl, unload
from pica_client.voice.mixer import VoiceMixer
from pica_client.voice.opus import OpusDecoder
from pica_client.voice.packet import SAMPLE_RATE_HZ
from pica_client.voice.sound.devices import Loudspeaker, Microphone, speakers
from pica_client.voice.source import shipped_speech


async def captured(name: str, seconds: float) -> tuple[np.ndarray, list[int], str]:
    """What a microphone hears."""
    microphone, stopping = Microphone(name), asyncio.Event()
    sounds, times_us = [], []
    async for sound, captured_us in microphone.frames(stopping):
        sounds.append(sound)
        times_us.append(captured_us)
        if len(sounds) * 0.02 >= seconds:
            stopping.set()
    return np.concatenate(sounds), times_us, microphone.state.name


def likeness(heard: np.ndarray, true: np.ndarray) -> float:
    """The largest normalised correlation of what was heard with any half second of what was said;
    a busy machine may tear one of them."""
    size = SAMPLE_RATE_HZ // 2
    best = 0.0
    for begin in range(size, 5 * size, size):
        piece = true[begin : begin + size]
        spectrum = np.fft.rfft(heard, 1 << 19) * np.fft.rfft(piece, 1 << 19).conj()
        products = np.abs(np.fft.irfft(spectrum))[: len(heard) - size]
        place = int(np.argmax(products))
        found = np.linalg.norm(heard[place : place + size])
        best = max(best, float(products[place] / found / np.linalg.norm(piece)))
    return best


def until(say: Callable[[], str]) -> str:
    """What is said, once anything is."""
    until_s = time.monotonic() + 8
    while not say() and time.monotonic() < until_s:
        time.sleep(0.05)
    return say()


def main() -> None:
    """Play, capture, unplug, plug."""
    speech = shipped_speech()
    said: dict[str, object] = {"speakers": speakers()}
    loudspeaker = Loudspeaker(VoiceMixer(OpusDecoder), "Speaker")
    loudspeaker.start()
    time.sleep(0.5)
    loudspeaker.play_test(speech)
    heard, times_us, said["captured_from"] = asyncio.run(captured("", 3.0))
    said["likeness"] = likeness(heard, speech)
    said["steps_us"] = [int(np.diff(times_us).min()), int(np.diff(times_us).max())]
    said["playing"], said["latency_s"] = loudspeaker.state.name, loudspeaker.state.latency_s
    unload("old")
    unload("spk")
    said["unplugged"] = until(lambda: loudspeaker.state.note)
    pactl("load-module", "module-null-sink", "sink_name=new")
    loudspeaker.choose("")
    said["plugged"] = until(lambda: loudspeaker.state.name)
    loudspeaker.stop()
    print(json.dumps(said))


if __name__ == "__main__":
    main()
