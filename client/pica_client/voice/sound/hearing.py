"""Everybody's voice at one receiver: network -> mixer -> loudspeaker, and faces that follow it."""

from typing import Any

import numpy as np

from pica_client.call.call import Call
from pica_client.call.held_lips import HeldLips
from pica_client.voice.opus import OpusDecoder, available
from pica_client.voice.packet import VoicePacket
from pica_client.voice.sound.process import SoundProcess

WIDTH_RAD = 0.7
"""How far to a side the outermost is heard (chosen: five people are told apart)."""


class Hearing:
    """Plays the voices of a call; faces are led by what leaves the loudspeaker."""

    def __init__(self, call: Call, sound: SoundProcess) -> None:
        self._sound = sound
        self._call = call
        self._known: set[str] = set()
        call.heard_us = sound.heard_us
        self._lips = call.lips = HeldLips(OpusDecoder)

    def receive(self, peer_id: str, packet: VoicePacket, arrived_s: float) -> None:
        """Take a packet of somebody's voice; who is new takes a place among the others."""
        if peer_id not in self._known:
            names = [*self._call.names()]
            if peer_id not in names:
                names.append(peer_id)  # a voice without a face
            self._known = set(names)
            self._lips.keep(self._known)
            places = np.linspace(-1, 1, len(names)) if len(names) > 1 else (0.0,)
            self._sound.seat(
                {who: WIDTH_RAD * float(at) for who, at in zip(names, places, strict=True)}
            )
        self._sound.receive(peer_id, packet, arrived_s)
        self._lips.receive(peer_id, packet)

    def stats(self) -> dict[str, Any]:
        """How sound and faces went since the call's statistics began.

        ``mouth_to_ear_ms`` means something only where sender and receiver share a clock.
        """
        voices, speaker = self._sound.stats(), self._sound.state.speaker
        ratios = [voice["concealed_ratio"] for voice in voices.values()]
        return {
            "skew_ms": self._call.skews_s.summary_ms(),
            "mouth_to_ear_ms": self._call.delays_s.summary_ms(),
            "concealed_ratio": round(sum(ratios) / len(ratios), 4) if ratios else None,
            "loudspeaker": speaker.name,
            "trouble": speaker.note or available() or "",
            "voices": dict(voices),
        }
