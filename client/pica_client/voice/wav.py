"""Speech from a WAV file, as a microphone would give it."""

import wave
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

from pica_client.errors import SourceError
from pica_client.voice.packet import SAMPLE_RATE_HZ as RATE_HZ
from pica_core.types import FloatArray

MAX_SECONDS = 600
MIN_RATE_HZ, MAX_RATE_HZ = 8000, 192_000
TAPS = 32
"""Samples on each side that a new sample is made of."""


def shipped_speech() -> FloatArray:
    """Three sentences, made by eSpeak NG; `docs/voice.md` says how. float32 at `RATE_HZ`."""
    with as_file(files("pica_client.voice") / "data" / "sentences.wav") as path:
        return read_wav(path)


def read_wav(path: Path) -> FloatArray:
    """The sound of a file, its channels mixed. float32 at `RATE_HZ`, in [-1, 1].

    Raises:
        SourceError: It is no WAV file of 16 bits a sample, or longer than `MAX_SECONDS`.
    """
    try:
        with wave.open(str(path), "rb") as file:
            rate_hz, num_frames = file.getframerate(), file.getnframes()
            if file.getsampwidth() != 2:
                raise SourceError(f"{path}: {8 * file.getsampwidth()} bits a sample; 16 are needed")
            if not MIN_RATE_HZ <= rate_hz <= MAX_RATE_HZ:
                raise SourceError(
                    f"{path}: {rate_hz} Hz; {MIN_RATE_HZ} to {MAX_RATE_HZ} are allowed"
                )
            if num_frames > MAX_SECONDS * rate_hz:
                raise SourceError(f"{path}: {num_frames / rate_hz:.0f} s; {MAX_SECONDS} at most")
            read = file.readframes(num_frames)
            data = np.frombuffer(read[: len(read) // 2 * 2], "<i2")  # it may be cut off
            channels = file.getnchannels()
    except (OSError, EOFError, wave.Error) as error:
        raise SourceError(
            f"{path}: no WAV file of PCM sound: {str(error) or 'it is cut off'}"
        ) from error
    if len(data) < channels:
        raise SourceError(f"{path}: no sound in it")
    sound = data[: len(data) // channels * channels].reshape(-1, channels).mean(axis=1)
    return resampled((sound / 32768).astype(np.float32), rate_hz, RATE_HZ)


def resampled(sound: FloatArray, rate_hz: int, to_hz: int) -> FloatArray:
    """A sound at another rate: a sinc under a Hann window, cut off below both rates' limits."""
    if rate_hz == to_hz:
        return sound
    step = rate_hz / to_hz
    cutoff = 0.95 * min(1.0, 1 / step)
    taps = int(np.ceil(TAPS / cutoff))
    padded = np.pad(sound, taps)
    pieces = []
    count = int(len(sound) / step)
    for begin in range(0, count, RATE_HZ):  # a second at a time: bounded memory
        places = np.arange(begin, min(begin + RATE_HZ, count)) * step
        whole = places.astype(np.int64)
        offsets = np.arange(-taps + 1, taps + 1)
        distance = offsets - (places - whole)[:, None]
        window = 0.5 + 0.5 * np.cos(np.pi * np.clip(distance / taps, -1, 1))
        weights = cutoff * np.sinc(cutoff * distance) * window
        pieces.append((padded[whole[:, None] + offsets + taps] * weights).sum(axis=1))
    return np.concatenate(pieces).astype(np.float32) if pieces else sound[:0]
