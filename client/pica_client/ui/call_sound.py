"""The voices of a call as the window needs them: the user's, those of others, the devices."""

from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from typing import Any

from pica_client.call.call import Call
from pica_client.call.roster import Member
from pica_client.stats import summarise_ms
from pica_client.ui.recorder import Soundtrack
from pica_client.ui.state import Sent, ViewState
from pica_client.voice.sound.process import SoundProcess
from pica_client.voice.sound.settings import SoundSettings, SoundState
from pica_client.voice.source import VoicePublisher
from pica_core.types import FloatArray

TAIL_S = 0.2
"""How long the user is heard after letting go of the key to talk: a key goes up with the last word
(chosen)."""


class CallSound:
    """What the drawing side knows of voices.

    Args:
        own: Sends the user's own voice; None: none is sent.
        sound: Plays those of the others, and captures; None: the others are not heard.
    """

    def __init__(
        self, own: VoicePublisher | None = None, sound: SoundProcess | None = None
    ) -> None:
        self._own, self._sound = own, sound
        self._set: SoundSettings | None = None
        self._volumes: Mapping[str, float] = {}
        self._talked_s = -TAIL_S
        self._trouble = ""

    @property
    def own_voice(self) -> Sent:
        """What becomes of the user's own voice at first."""
        return "none" if self._own is None else "sent"

    def state(self) -> SoundState | None:
        """How sound stands; None: there is none."""
        return None if self._sound is None else self._sound.state

    def levels(self) -> Mapping[str, int]:
        """How loud each voice is, by peer id; see `voice.opus.level_of`."""
        voices = {} if self._sound is None else self._sound.state.voices
        return {peer_id: voice.level for peer_id, voice in voices.items()}

    def follow(self, wanted: ViewState, people: Iterable[Member], now: float) -> str:
        """Do what the user wants; gives what has just gone wrong with a device, else nothing."""
        if self._own is not None:
            if wanted.is_heard:
                self._talked_s = now
            ends_softly = wanted.own_voice == "sent" and now - self._talked_s < TAIL_S
            self._own.is_muted = not (wanted.is_heard or ends_softly)
        if self._sound is None:
            return ""
        if wanted.sound != self._set:
            self._set = wanted.sound
            self._sound.follow(wanted.sound)
        volumes = {
            person.peer_id: wanted.volumes[person.place]
            for person in people
            if person.place in wanted.volumes
        }
        if volumes != self._volumes:
            self._volumes = volumes
            self._sound.set_volumes(volumes)
        before, self._trouble = self._trouble, self._sound.state.trouble
        return self._trouble if self._trouble != before else ""

    def report(self, call: Call) -> dict[str, Any] | None:
        """How sound and the faces of a call went since the call's statistics began; None where the
        others are not heard.

        ``mouth_to_ear_ms`` means something only where sender and receiver share a clock.
        """
        if self._sound is None or call.ears is None:
            return None
        state = self._sound.state
        voices = {peer_id: voice.report for peer_id, voice in state.voices.items()}
        ratios = [voice.concealed_ratio for voice in voices.values()]
        return {
            "skew_ms": summarise_ms(call.skews_s),
            "mouth_to_ear_ms": summarise_ms(call.delays_s),
            "concealed_ratio": round(sum(ratios) / len(ratios), 4) if ratios else None,
            "loudspeaker": state.speaker.name,
            "trouble": state.speaker.note,
            "voices": {peer_id: asdict(voice) for peer_id, voice in voices.items()},
        }

    def begin_track(self) -> Soundtrack | None:
        """Begin to keep all that is heard, and what is sent of the own voice, for one recording;
        None where there is neither."""
        if self._sound is None and self._own is None:
            return None
        stack = ExitStack()
        track = Soundtrack(stack.close)

        def keep_own(sound: FloatArray, captured_us: int) -> None:
            track.add("own", sound, captured_us / 1e6)

        if self._own is not None:
            self._own.listeners.append(keep_own)
            stack.callback(self._own.listeners.remove, keep_own)
        if self._sound is not None:
            self._sound.hand_mix_to(partial(track.add, "others"))
            stack.callback(self._sound.hand_mix_to, None)
        return track
