"""Sound in its process, over the devices of `sound_server`, as tests and scripts try it."""

import time
from collections.abc import Callable

import numpy as np

from pica_client.voice.opus import OpusEncoder
from pica_client.voice.packet import FRAME_S, FRAME_SAMPLES, MAX_LEVEL
from pica_client.voice.sound.process import SoundProcess
from pica_client.voice.sound.settings import SoundSettings
from pica_client.voice.source import shipped_speech
from pica_core.types import FloatArray
from pica_protocol.frames import Frame


def until(holds: Callable[[], object], seconds: float = 8.0) -> bool:
    """Wait until something holds; whether it did in time."""
    until_s = time.monotonic() + seconds
    while not holds() and time.monotonic() < until_s:
        time.sleep(0.02)
    return bool(holds())


def say(sound: SoundProcess, seconds: float, peer_id: str = "ann") -> tuple[int, int]:
    """Let somebody say the sentences that ship, in real time; the loudest levels of loudspeaker
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


def echo_db(sound: SoundProcess, settings: SoundSettings, seconds: float = 6.0) -> float:
    """How loud what is said by somebody else comes through the microphone, decibels below full
    scale, after the first half, in which the canceller learns."""
    heard: list[FloatArray] = []
    sound.follow(settings)
    sound.use_microphone(True)
    until(lambda: sound.state.microphone.name)
    sound.on_frame = lambda frame, captured_us: heard.append(frame)
    say(sound, seconds)
    sound.on_frame = lambda *_: None
    sound.use_microphone(False)
    rest = np.concatenate(heard)[len(heard) * FRAME_SAMPLES // 2 :]
    return float(-10 * np.log10(np.mean(np.square(rest, dtype=np.float64)) + 1e-13))
