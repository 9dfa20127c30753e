"""Everybody's voice at one receiver: network -> mixer -> loudspeaker, and faces that follow it."""

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from pica_client.call.call import Call
from pica_client.voice.devices import Loudspeaker
from pica_client.voice.mixer import VoiceMixer
from pica_client.voice.opus import OpusDecoder, available
from pica_client.voice.packet import VoicePacket

WIDTH_RAD = 0.7
"""How far to a side the outermost is heard (chosen: five people are told apart)."""


class Hearing:
    """Plays the voices of a call; faces are led by what leaves the loudspeaker.

    Attributes:
        mixer: Knows volumes, seats and levels.
        loudspeaker: Can be chosen anew at any time, and says how it stands.
    """

    def __init__(self, call: Call, speaker: str = "") -> None:
        """Prepare.

        Args:
            call: Whose faces follow.
            speaker: Name of the loudspeaker; empty for the system's default, ``none`` for no sound.

        Raises:
            VoiceError: There is no libopus.
        """
        OpusDecoder()
        self.mixer = VoiceMixer(OpusDecoder)
        self.loudspeaker = Loudspeaker(self.mixer, speaker)
        self._call = call
        self._known: set[str] = set()
        call.heard_us = self.mixer.heard_us

    def receive(self, peer_id: str, packet: VoicePacket, arrived_s: float) -> None:
        """Take a packet of somebody's voice; who is new takes a place among the others."""
        if peer_id not in self._known:
            names = [*self._call.names()]
            if peer_id not in names:
                names.append(peer_id)  # a voice without a face
            self._known = set(names)
            self.mixer.keep(names)
            places = np.linspace(-1, 1, len(names)) if len(names) > 1 else (0.0,)
            self.mixer.seat(
                {who: WIDTH_RAD * float(at) for who, at in zip(names, places, strict=True)}
            )
        self.mixer.receive(peer_id, packet, arrived_s)

    @contextlib.contextmanager
    def playing(self) -> Iterator[None]:
        """Play as long as the block runs."""
        self.loudspeaker.start()
        try:
            yield
        finally:
            self.loudspeaker.stop()

    def stats(self) -> dict[str, Any]:
        """How sound and faces went since the call's statistics began.

        ``mouth_to_ear_ms`` means something only where sender and receiver share a clock.
        """
        voices = self.mixer.stats()
        ratios = [voice["concealed_ratio"] for voice in voices.values()]
        return {
            "skew_ms": self._call.skews_s.summary_ms(),
            "mouth_to_ear_ms": self._call.delays_s.summary_ms(),
            "concealed_ratio": round(sum(ratios) / len(ratios), 4) if ratios else None,
            "loudspeaker": self.loudspeaker.state.name,
            "trouble": self.loudspeaker.state.note or available() or "",
            "voices": voices,
        }
