"""All voices at one receiver: network -> mixer -> loudspeaker, and faces that follow it."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from pica_client.call.call import Call, Ears
from pica_client.call.roster import Member
from pica_client.voice.opus import available
from pica_client.voice.sound.process import SoundProcess
from pica_protocol.frames import Frame

WIDTH_RAD = 0.7
"""How far to a side the outermost is heard (chosen: five people are told apart)."""


class Hearing(Ears):
    """Plays the voices of a call; faces are led by what leaves the loudspeaker. Give it to the call
    as its ears."""

    def __init__(self, sound: SoundProcess) -> None:
        self._sound = sound
        self._seated: list[str] = []

    def heard_us(self, peer_id: str, now: float) -> int | None:
        """The moment of a peer's voice, on its clock, that leaves the loudspeaker now."""
        return self._sound.heard_us(peer_id, now)

    def seat(self, members: Sequence[Member]) -> None:
        """Give each member with a face or a voice a place, in the order of coming; forget
        others."""
        seated = [each.peer.peer_id for each in members if each.has_voice or not each.is_watching]
        if seated != self._seated:
            self._seated = seated
            places = np.linspace(-1, 1, len(seated)) if len(seated) > 1 else np.zeros(len(seated))
            self._sound.seat(dict(zip(seated, (WIDTH_RAD * places).tolist(), strict=True)))

    def receive(self, peer_id: str, packet: Frame, arrived_s: float) -> None:
        """Take a packet of a voice."""
        self._sound.receive(peer_id, packet, arrived_s)

    def stats(self, call: Call) -> dict[str, Any]:
        """How sound and the faces of a call went since the call's statistics began.

        ``mouth_to_ear_ms`` means something only where sender and receiver share a clock.
        """
        state = self._sound.state
        voices = {peer_id: voice.report for peer_id, voice in state.voices.items()}
        ratios = [voice.concealed_ratio for voice in voices.values()]
        return {
            "skew_ms": call.skews_s.summary_ms(),
            "mouth_to_ear_ms": call.delays_s.summary_ms(),
            "concealed_ratio": round(sum(ratios) / len(ratios), 4) if ratios else None,
            "loudspeaker": state.speaker.name,
            "trouble": state.speaker.note or available() or "",
            "voices": {peer_id: asdict(voice) for peer_id, voice in voices.items()},
        }
