"""All voices of a call as one sound, each from its seat. Pure but for a lock.

Packets come in on the network's thread, sound goes out on the loudspeaker's, and the display asks
what is heard on its own. `mix` is called every 20 ms.
"""

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from pica_client.voice.jitter_buffer import JitterBuffer, crossfade
from pica_client.voice.opus import FRAME_SAMPLES, MAX_LEVEL, OpusDecoder, level_of
from pica_client.voice.sound.settings import MixedVoice
from pica_core.types import Array, FloatArray
from pica_protocol.frames import Frame

LIMIT_FROM = 0.7
"""Above it the sum is bent rather than cut."""

FARTHER_SAMPLES = 32
"""By how much later the farther ear hears what comes from the side: 0.66 ms (Woodworth and
Schlosberg, Experimental Psychology, 1962)."""
FARTHER_LOSS = 0.5
"""Share by which it is softer there (chosen: the head is in the way of high tones alone)."""


def _heard(whole: Array, azimuth_rad: float) -> Array:
    """What both ears hear of a sound from a side, ``[2, samples - FARTHER_SAMPLES]``."""
    side = abs(math.sin(azimuth_rad))
    late = round(FARTHER_SAMPLES * side)
    near = whole[FARTHER_SAMPLES:]
    far = (1 - FARTHER_LOSS * side) * whole[FARTHER_SAMPLES - late : len(whole) - late]
    return np.stack((far, near) if azimuth_rad > 0 else (near, far))


class _Voice:
    """One person's voice at this end, and where it comes from; it moves within a frame."""

    def __init__(self, decoder: OpusDecoder) -> None:
        self.buffer = JitterBuffer(decoder)
        self.level = MAX_LEVEL
        self._azimuth_rad: float | None = None
        self._tail = np.zeros(FARTHER_SAMPLES)

    def pull(self, now: float, latency_s: float, azimuth_rad: float) -> Array:
        """The next 20 ms for both ears, float64 ``[samples, 2]``; a positive azimuth is to the
        right."""
        sound = self.buffer.pull(now, latency_s)
        self.level = level_of(sound)
        whole = np.concatenate([self._tail, sound])
        self._tail = whole[-FARTHER_SAMPLES:]
        both = _heard(whole, azimuth_rad)
        if self._azimuth_rad not in (None, azimuth_rad):
            both = crossfade(_heard(whole, self._azimuth_rad), both)
        self._azimuth_rad = azimuth_rad
        return both.T


class VoiceMixer:
    """Hears everybody.

    Attributes:
        volume: Of all voices; 1 is as they come.
        level: Of the last mix, see `level_of`.
        on_mixed: Is given each mixed frame with the time it leaves the loudspeaker, as for a
            recording. float32 ``[FRAME_SAMPLES, 2]``.
    """

    def __init__(self, make_decoder: Callable[[], OpusDecoder] = OpusDecoder) -> None:
        self.volume, self.level = 1.0, MAX_LEVEL
        self.on_mixed: Callable[[FloatArray, float], None] | None = None
        self._make_decoder = make_decoder
        self._lock = threading.Lock()
        self._voices: dict[str, _Voice] = {}  # bounded by the room's seats
        self._volumes: dict[str, float] = {}
        self._azimuths: dict[str, float] = {}

    def receive(self, peer_id: str, packet: Frame, arrived_s: float) -> None:
        """Take a packet of a peer's voice."""
        with self._lock:
            voice = self._voices.get(peer_id)
            if voice is None:
                voice = self._voices[peer_id] = _Voice(self._make_decoder())
            voice.buffer.receive(packet, arrived_s)

    def set_volumes(self, volumes: Mapping[str, float]) -> None:
        """Make people louder or softer, by peer id: 1 is as sent, 0 mutes them here."""
        with self._lock:
            self._volumes |= volumes

    def seat(self, azimuths_rad: Mapping[str, float]) -> None:
        """Set the peers that are there and where each voice comes from, by peer id; positive is to
        the right. Others have left, and are forgotten."""
        with self._lock:
            self._azimuths = dict(azimuths_rad)
            for homes in (self._voices, self._volumes):
                for peer_id in set(homes) - set(azimuths_rad):
                    del homes[peer_id]

    def mix(self, now: float, latency_s: float = 0.0) -> FloatArray:
        """The next 20 ms for both ears, float32 ``[FRAME_SAMPLES, 2]`` in [-1, 1].

        Args:
            now: Our clock.
            latency_s: Until the first sample leaves the loudspeaker.
        """
        mixed = np.zeros((FRAME_SAMPLES, 2))
        with self._lock:
            for peer_id, voice in self._voices.items():
                azimuth_rad = self._azimuths.get(peer_id, 0.0)
                volume = self._volumes.get(peer_id, 1.0)
                mixed += volume * voice.pull(now, latency_s, azimuth_rad)
        limited = limit(self.volume * mixed).astype(np.float32)
        self.level = level_of(limited)
        if self.on_mixed is not None:
            self.on_mixed(limited, now + latency_s)
        return limited

    def voices(self) -> dict[str, MixedVoice]:
        """What was mixed last of each voice, by peer id."""
        with self._lock:
            return {
                peer_id: MixedVoice(voice.level, voice.buffer.moment, replace(voice.buffer.report))
                for peer_id, voice in self._voices.items()
            }


def limit(sound: Array) -> Array:
    """The sound within [-1, 1], bent softly where it is loud."""
    over = np.abs(sound) - LIMIT_FROM
    room = 1 - LIMIT_FROM
    bent = np.sign(sound) * (LIMIT_FROM + room * np.tanh(np.maximum(over, 0) / room))
    return np.where(over > 0, bent, sound)
