"""A voice on its way out: a microphone, or a sound that is looped -> Opus -> packets on the voice's
track, two frames in each.

While it is muted, or its speaker silent, nothing is sent. A mute lets the frame that was begun go
out, and then one of nothing, which brings out what the encoder held back; nothing that was captured
later leaves this machine or is kept on it.
"""

import asyncio
import math
import queue
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable
from importlib.resources import as_file, files
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO, Final, Protocol

import numpy as np

from pica_client.errors import OptionError, SourceError
from pica_client.system import say
from pica_client.tracks import VOICE_KEY, VOICE_MUTED, VOICE_TRACK
from pica_client.transport.link import Link, sleep_until
from pica_client.voice.opus import FRAME_S, FRAME_SAMPLES, FRAME_US, PACKET_FRAMES, OpusEncoder
from pica_client.voice.opus import SAMPLE_RATE_HZ as RATE_HZ
from pica_client.voice.sound.process import SoundProcess
from pica_client.voice.sound.settings import NO_DEVICE, NO_LIBRARY, SoundSettings
from pica_core.types import Array, FloatArray
from pica_protocol.messages import Track

BITRATE_BPS: Final = 24_000
"""Bits a second during speech."""
DEADLINE_MS: Final = 200
"""How long a packet may wait on its way (chosen: as the longest wait before it is heard)."""
_NOTHING: Final = np.zeros(FRAME_SAMPLES, np.float32)
_GAP_US: Final = FRAME_US // 2
"""Between the end of a packet and the beginning of the next; more is a silence."""


class VoiceSource(Protocol):
    """What a voice comes from: a microphone, a file."""

    def frames(self, stopping: asyncio.Event) -> AsyncIterator[tuple[FloatArray, int]]:
        """Return 20 ms after 20 ms, float32 ``[960]`` in [-1, 1], as they are captured.

        With each comes when its first sample was captured, microseconds of the event loop's clock.
        Ends when told to stop.
        """


class VoicePublisher:
    """Sends one voice over a link, which the caller runs.

    Attributes:
        is_muted: Whether its owner has muted it, from the next frame on; any thread may set it.
        listeners: Take what is captured and not muted: samples, and when the first was captured.
    """

    def __init__(self, source: VoiceSource, *, is_sealed: bool = False) -> None:
        """Prepare.

        Args:
            is_sealed: Whether it is encrypted on its way: then every packet of speech has the same
                size, as sizes that follow the sounds tell words (RFC 6562).

        Raises:
            VoiceError: There is no libopus.
        """
        self.track = Track(kind=VOICE_TRACK, deadline_ms=DEADLINE_MS)
        self.is_muted = False
        self.listeners: list[Callable[[FloatArray, int], None]] = []
        self._source = source
        self._encoder = OpusEncoder(BITRATE_BPS, is_constant=is_sealed)
        self._was_muted = False
        self._begun: list[FloatArray] = []  # of the next packet, and when it was captured
        self._begun_us = 0
        self._sent = self._payload_bytes = 0

    async def pace(self, link: Link, stopping: asyncio.Event) -> None:
        """Send until told to stop, or the source ends."""
        async for pcm, captured_us in self._source.frames(stopping):
            self.send(link, pcm, captured_us)

    def send(self, link: Link, pcm: FloatArray, captured_us: int) -> None:
        """Send the next 20 ms, unless it is silent or there is no room to send it to."""
        is_muted = self.is_muted  # another thread may change it meanwhile
        was_muted, self._was_muted = self._was_muted, is_muted
        if is_muted != was_muted:
            link.describe(VOICE_KEY, VOICE_MUTED if is_muted else "")
            if was_muted:
                self._encoder.reset()
        if is_muted and was_muted:
            return
        for listen in () if is_muted else tuple(self.listeners):
            listen(pcm, captured_us)
        self._send(link, _NOTHING if is_muted else pcm, captured_us, is_last=is_muted)

    def _send(self, link: Link, pcm: FloatArray, captured_us: int, *, is_last: bool) -> None:
        if not link.is_joined:
            self._begun.clear()
            return
        if self._begun and captured_us > self._begun_us + len(self._begun) * FRAME_US + _GAP_US:
            self._send_packet(link)  # the source has left something out
        if not self._begun:
            self._begun_us = captured_us
        self._begun.append(pcm)
        if is_last or len(self._begun) == PACKET_FRAMES:
            self._send_packet(link)

    def _send_packet(self, link: Link) -> None:
        pcm, captured_us = np.concatenate(self._begun), self._begun_us
        self._begun.clear()
        opus = self._encoder.encode(pcm)
        if opus is not None and link.send_frame(opus, captured_us, track=self.track):
            self._sent += 1
            self._payload_bytes += len(opus)

    def stats(self) -> dict[str, Any]:
        """What was sent so far."""
        return {"sent": self._sent, "payload_bytes": self._payload_bytes, "muted": self.is_muted}


TURN_S: Final = 4.0
"""How long each speaks where several take turns (chosen: a sentence or two)."""
_LATEST_S: Final = 0.2
"""A source that is later than this leaves out what it has missed: a microphone does not wait."""

MAX_SECONDS = 600
MIN_RATE_HZ, MAX_RATE_HZ = 8000, 96_000
WAITING_FRAMES = 10
"""Read ahead of a pipe at most; then its writer waits."""
TAIL_FRAMES = 25
"""Silence after its end, in which the last sound leaves."""


class SoundSource:
    """A sound, looped; a `VoiceSource`.

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


class PcmSource:
    """A `VoiceSource` of 16-bit PCM that another program writes, as fast as it is spoken or faster;
    silent while nothing is written.

    Args:
        file: Signed 16-bit little-endian samples, one channel; 20 ms are played once they are
            complete.
        rate_hz: Their rate, a multiple of 50.

    Raises:
        OptionError: It is another rate.
    """

    def __init__(self, file: BinaryIO, rate_hz: int) -> None:
        if not MIN_RATE_HZ <= rate_hz <= MAX_RATE_HZ or rate_hz % 50:
            allowed = f"multiples of 50 from {MIN_RATE_HZ} to {MAX_RATE_HZ} are allowed"
            raise OptionError(f"rate is {rate_hz} Hz; {allowed}")
        self._file, self._rate_hz = file, rate_hz
        self._read: queue.Queue[bytes | None] = queue.Queue(WAITING_FRAMES)

    async def frames(self, stopping: asyncio.Event) -> AsyncIterator[tuple[FloatArray, int]]:
        """Return 20 ms after 20 ms; see `VoiceSource.frames`."""
        threading.Thread(target=self._pump, daemon=True).start()
        silence = np.zeros(self._rate_hz // 50, np.float32)
        around, tail = deque([silence] * 3, maxlen=3), 0
        captured_s = asyncio.get_running_loop().time()
        while tail < TAIL_FRAMES and not stopping.is_set():
            now = await sleep_until(captured_s + FRAME_S)
            data = b"" if tail or self._read.empty() else self._read.get()
            if data is None or tail:
                data, tail = b"", tail + 1
            pcm = silence.copy()
            pcm[: len(data) // 2] = np.frombuffer(data, "<i2", len(data) // 2) / 32768
            around.append(pcm)
            # Among its neighbours, for a rate is changed by the spectrum.
            wide = resampled(np.concatenate(around), self._rate_hz, RATE_HZ)
            yield wide[FRAME_SAMPLES : 2 * FRAME_SAMPLES], round(captured_s * 1e6)
            captured_s = max(captured_s + FRAME_S, now - FRAME_S)

    def _pump(self) -> None:
        size, data = 2 * (self._rate_hz // 50), b""
        while new := self._file.read(size - len(data)):
            data += new
            if len(data) == size:
                self._read.put(data)
                data = b""
        self._read.put(data)
        self._read.put(None)


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
        ModuleNotFoundError: It needs the extra ``video``.
        SourceError: It is no WAV file, or longer than `MAX_SECONDS`.
    """
    import av  # needed by files alone

    parts: list[Array] = []
    try:
        with av.open(str(path), format="wav") as container:
            rate_hz = container.streams.audio[0].rate
            if not MIN_RATE_HZ <= rate_hz <= MAX_RATE_HZ:
                allowed = f"{MIN_RATE_HZ} to {MAX_RATE_HZ} are allowed"
                raise SourceError(f"{path}: {rate_hz} Hz; {allowed}")
            convert, count = av.AudioResampler("fltp"), 0
            for frame in container.decode(audio=0):
                parts += [each.to_ndarray().mean(axis=0) for each in convert.resample(frame)]
                count += frame.samples
                if count > MAX_SECONDS * rate_hz:
                    raise SourceError(f"{path}: at most {MAX_SECONDS} s of sound are played")
    except (av.FFmpegError, OSError, IndexError, AttributeError) as error:
        raise SourceError(f"{path}: no WAV file of PCM sound: {error}") from error
    if not parts:
        raise SourceError(f"{path}: no WAV file of PCM sound: it holds none")
    sound = np.nan_to_num(np.concatenate(parts)).clip(-1, 1)
    return resampled(sound.astype(np.float32), rate_hz, RATE_HZ)


def resampled(sound: FloatArray, rate_hz: int, to_hz: int) -> FloatArray:
    """A sound at another rate, by its spectrum: right for what is looped. float32."""
    if rate_hz == to_hz:
        return sound
    count = max(len(sound) * to_hz // rate_hz, 1)
    spectrum = np.fft.rfft(sound)
    return (np.fft.irfft(spectrum, count) * (count / len(sound))).astype(np.float32)
