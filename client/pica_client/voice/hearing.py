"""Everybody's voice at one receiver: network -> mixer -> loudspeaker, and faces that follow it."""

import contextlib
from collections.abc import Iterator
from typing import Any

from pica_client.call.call import Call
from pica_client.voice.devices import Loudspeaker
from pica_client.voice.mixer import VoiceMixer
from pica_client.voice.opus import OpusDecoder, available


class Hearing:
    """Plays the voices of a call; faces are led by what leaves the loudspeaker.

    Attributes:
        mixer: Takes packets (`VoiceMixer.receive`), and knows volumes, seats and levels.
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
        call.heard_us = self.mixer.heard_us

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
