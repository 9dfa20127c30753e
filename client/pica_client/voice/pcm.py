"""A voice that another program writes: 16-bit PCM, as fast as it is spoken or faster."""

import asyncio
import queue
import threading
from collections import deque
from collections.abc import AsyncIterator
from typing import BinaryIO

import numpy as np

from pica_client.errors import OptionError
from pica_client.transport.link import sleep_until
from pica_client.voice.opus import FRAME_S, FRAME_SAMPLES
from pica_client.voice.opus import SAMPLE_RATE_HZ as RATE_HZ
from pica_client.voice.source import MAX_RATE_HZ, MIN_RATE_HZ, resampled
from pica_core.types import FloatArray

WAITING_FRAMES = 10
"""Read ahead at most; then the writer waits."""
TAIL_FRAMES = 25
"""Silence after the end, in which the last sound leaves."""


class PcmSource:
    """A `VoiceSource` over a file or pipe; silent while nothing is written.

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
