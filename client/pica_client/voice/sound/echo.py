"""Echo cancellation, noise suppression and gain, by WebRTC's own (the `livekit` wheel).

What the loudspeaker plays must pass `play`, what the microphone hears `clean`; both 20 ms at a time
and on threads of their own.
"""

import threading
from typing import Any

import numpy as np

from pica_client.errors import VoiceError
from pica_client.voice.packet import FRAME_SAMPLES, SAMPLE_RATE_HZ
from pica_core.types import Array, FloatArray

PART = FRAME_SAMPLES // 2
"""Samples that are processed at once: 10 ms."""
MAX_DELAY_MS = 500


class EchoCanceller:
    """Takes out of a microphone what the loudspeaker put into it.

    Raises:
        VoiceError: The extra is missing; names the line that installs it.
    """

    def __init__(self, *, gain_control: bool = True) -> None:
        try:
            from livekit import rtc
        except ImportError as error:
            raise VoiceError(
                "echo cancellation is missing: pip install 'pica-telepresence[echo]'"
            ) from error
        self._frame: Any = rtc.AudioFrame
        self._apm: Any = rtc.AudioProcessingModule(
            echo_cancellation=True,
            noise_suppression=True,
            high_pass_filter=True,
            auto_gain_control=gain_control,
        )
        self._lock = threading.Lock()

    def set_delay(self, seconds: float) -> None:
        """Set how long sound takes from `play` to the loudspeaker and from the air to `clean`."""
        with self._lock:
            self._apm.set_stream_delay_ms(min(max(round(seconds * 1e3), 0), MAX_DELAY_MS))

    def play(self, sound: Array) -> None:
        """Take what is played now: float32 ``[FRAME_SAMPLES]`` or ``[FRAME_SAMPLES, 2]``."""
        mono = sound if sound.ndim == 1 else sound.mean(axis=1)
        for part in mono.reshape(-1, PART):
            with self._lock:
                self._apm.process_reverse_stream(self._part(part))

    def clean(self, sound: FloatArray) -> FloatArray:
        """What is left of a frame of the microphone without echo and noise."""
        parts = []
        for part in sound.reshape(-1, PART):
            frame = self._part(part)
            with self._lock:
                self._apm.process_stream(frame)
            parts.append(np.frombuffer(frame.data, np.int16))
        cleaned: FloatArray = (np.concatenate(parts) / 32768).astype(np.float32)
        return cleaned

    def _part(self, sound: Array) -> Any:
        data = np.round(np.clip(sound, -1, 1) * 32767).astype(np.int16).tobytes()
        return self._frame(data, SAMPLE_RATE_HZ, 1, PART)
