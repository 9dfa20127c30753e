"""Where a voice comes from: a microphone, or a sound that is looped."""

import asyncio
import math
import struct
from collections.abc import AsyncIterator
from importlib.resources import as_file, files
from importlib.util import find_spec
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from pica_client.errors import OptionError, SourceError
from pica_client.system import say
from pica_client.transport.link import sleep_until
from pica_client.voice.opus import FRAME_S, FRAME_SAMPLES
from pica_client.voice.opus import SAMPLE_RATE_HZ as RATE_HZ
from pica_client.voice.publisher import VoiceSource
from pica_client.voice.sound.process import SoundProcess
from pica_client.voice.sound.settings import NO_DEVICE, NO_LIBRARY, SoundSettings
from pica_core.types import FloatArray

TURN_S: Final = 4.0
"""How long each speaks where several take turns (chosen: a sentence or two)."""
_LATEST_S: Final = 0.2
"""A source that is later than this leaves out what it has missed: a microphone does not wait."""

MAX_SECONDS = 600
MIN_RATE_HZ, MAX_RATE_HZ = 8000, 96_000
SAMPLES: Final = {(1, 16): "<i2", (1, 24): "<i4", (1, 32): "<i4", (3, 32): "<f4"}
"""What is read, by format (1: whole numbers, 3: floats) and bits; 24 bits become the upper ones."""
EXTENSIBLE: Final = 0xFFFE
"""Format whose true one stands behind it."""
UNKNOWN_BYTES: Final = (0, 0xFFFF_FFFF)
"""Lengths of sound that stand in a header which was written before it."""


class SoundSource:
    """A sound, looped; a `publisher.VoiceSource`.

    Args:
        sound: float32, mono, 48 kHz, at least one sample.
        turn: In which turn it is heard, from 0, by the clock that all processes of a machine share;
            at other times there is silence, and the sound waits.
        num_turns: How many there are.
    """

    def __init__(self, sound: FloatArray, turn: int = 0, num_turns: int = 1) -> None:
        self._sound, self._turn, self._num_turns = sound, turn, num_turns

    async def frames(self, stopping: asyncio.Event) -> AsyncIterator[tuple[FloatArray, int]]:
        """Return 20 ms after 20 ms; see `VoiceSource.frames`."""
        begin_s = asyncio.get_running_loop().time()
        index = at = 0
        while True:
            captured_s = begin_s + index * FRAME_S
            now = await sleep_until(captured_s + FRAME_S)
            if stopping.is_set():
                return
            if math.floor(captured_s / TURN_S) % self._num_turns == self._turn:
                places = np.arange(at, at + FRAME_SAMPLES) % len(self._sound)
                pcm, at = self._sound[places], at + FRAME_SAMPLES
            else:
                pcm = np.zeros(FRAME_SAMPLES, np.float32)
            yield pcm, round(captured_s * 1e6)
            late = (now - captured_s) / FRAME_S - 1
            index += 1 + (math.floor(late) if late * FRAME_S > _LATEST_S else 0)


def open_voice(text: str, *, cleans: bool = True) -> VoiceSource | None:
    """Open what the option ``--voice`` names; None: no voice.

    Args:
        text: ``none``; ``speech``, the sentences that ship, or ``speech#K/N``, the K-th of N who
            take turns with them; ``mic``, the system's microphone, or ``mic:NAME``; or a WAV file.
        cleans: Whether to take noise out of what the microphone hears, where the extra ``echo`` is
            installed. What is wrong with the microphone is said whenever that changes.

    Raises:
        ModuleNotFoundError: A microphone needs the extra ``voice``.
        OptionError: It is a turn that cannot be.
        SourceError: The file is no WAV file that can be played.
    """
    if text == "none":
        return None
    kind, _, device = text.partition(":")
    if kind == "mic":
        if find_spec("soundcard") is None:
            raise ModuleNotFoundError(NO_LIBRARY, name="soundcard")
        sound = SoundProcess(SoundSettings(microphone=device, speaker=NO_DEVICE, cleans=cleans))
        sound.on_trouble = lambda note: say(note or "the microphone is there again")
        return sound
    name, mark, turns = text.partition("#")
    if name != "speech":
        return SoundSource(read_wav(Path(text)))
    if not mark:
        return SoundSource(shipped_speech())
    index, _, count = turns.partition("/")
    if not (index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count) <= 64):
        raise OptionError(f"voice is {text!r}; speech#K/N with 1 <= K <= N <= 64 is allowed")
    return SoundSource(shipped_speech(), int(index) - 1, int(count))


def shipped_speech() -> FloatArray:
    """Three sentences, made by eSpeak NG; `docs/voice.md` says how. float32 at `RATE_HZ`."""
    with as_file(files("pica_client.voice") / "data" / "sentences.wav") as path:
        return read_wav(path)


def read_wav(path: Path) -> FloatArray:
    """The sound of a file, its channels mixed. float32 at `RATE_HZ`, in [-1, 1].

    What is there is read: a file that was cut, or whose length was not known when its header was
    written, ends where its bytes end.

    Raises:
        SourceError: It is no WAV file of such samples, or longer than `MAX_SECONDS`.
    """
    try:
        with path.open("rb") as file:
            layout, num_bytes = _find_sound(file)
            tag, channels, rate_hz, _, _, bits = struct.unpack_from("<HHIIHH", layout)
            if tag == EXTENSIBLE:
                (tag,) = struct.unpack_from("<H", layout, 24)
            if (tag, bits) not in SAMPLES:
                raise SourceError(f"{path}: {bits} bits of format {tag}; 16-bit PCM is needed")
            if not MIN_RATE_HZ <= rate_hz <= MAX_RATE_HZ:
                allowed = f"{MIN_RATE_HZ} to {MAX_RATE_HZ} are allowed"
                raise SourceError(f"{path}: {rate_hz} Hz; {allowed}")
            block = channels * bits // 8
            longest = (MAX_SECONDS * rate_hz + 1) * block
            data = file.read(longest if num_bytes in UNKNOWN_BYTES else min(num_bytes, longest))
    except (OSError, ValueError, struct.error) as error:
        raise SourceError(f"{path}: no WAV file of PCM sound: {error}") from error
    count = len(data) // block if block else 0
    if not 0 < count <= MAX_SECONDS * rate_hz:
        seconds = count / rate_hz
        raise SourceError(f"{path}: {seconds:.0f} s of sound; above 0 to {MAX_SECONDS} are played")
    stored = np.frombuffer(data, np.uint8, count * block).reshape(-1, bits // 8)
    if bits == 24:
        stored = np.pad(stored, ((0, 0), (1, 0)))
    samples = np.ascontiguousarray(stored).view(SAMPLES[tag, bits]).reshape(-1, channels)
    full = np.iinfo(samples.dtype).max + 1 if tag == 1 else 1
    sound = np.nan_to_num(samples.mean(axis=1, dtype=np.float64) / full).clip(-1, 1)
    return resampled(sound.astype(np.float32), rate_hz, RATE_HZ)


def _find_sound(file: BinaryIO) -> tuple[bytes, int]:
    """Read a file up to its sound; return what says how it is stored, and its bytes.

    Raises:
        ValueError: There is none.
    """
    kind, _, what = struct.unpack("<4sI4s", file.read(12))
    if kind not in (b"RIFF", b"RF64") or what != b"WAVE":
        raise ValueError("it begins otherwise")
    chunks: dict[bytes, bytes] = {}
    while len(start := file.read(8)) == 8:
        name, num_bytes = struct.unpack("<4sI", start)
        if name == b"data":
            if b"ds64" in chunks:  # lengths above 4 GB stand there
                (num_bytes,) = struct.unpack_from("<Q", chunks[b"ds64"], 8)
            return chunks.get(b"fmt ", b""), num_bytes
        chunks[name] = file.read(num_bytes + num_bytes % 2)
    raise ValueError("it has no sound")


def resampled(sound: FloatArray, rate_hz: int, to_hz: int) -> FloatArray:
    """A sound at another rate, by its spectrum: right for what is looped. float32."""
    if rate_hz == to_hz:
        return sound
    count = max(len(sound) * to_hz // rate_hz, 1)
    spectrum = np.fft.rfft(sound)
    return (np.fft.irfft(spectrum, count) * (count / len(sound))).astype(np.float32)
