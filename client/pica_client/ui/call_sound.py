"""The voices of a call as the window needs them: one's own to mute, and who is heard how loudly."""

from collections.abc import Mapping

from pica_client.ui.controls import OwnVoice
from pica_client.voice.hearing import Hearing
from pica_client.voice.publisher import VoicePublisher


class CallSound:
    """What the drawing side knows of voices.

    Args:
        own: Sends the user's own voice; None: none is sent.
        hearing: Plays those of the others; None: nobody is heard.
    """

    def __init__(self, own: VoicePublisher | None = None, hearing: Hearing | None = None) -> None:
        self._own, self._hearing = own, hearing

    @property
    def own_voice(self) -> OwnVoice:
        """What becomes of the user's own voice at first."""
        return "none" if self._own is None else "sent"

    def tell(self, wanted: OwnVoice) -> None:
        """Mute the user's own voice, or let it go on."""
        if self._own is not None:
            self._own.set_muted(wanted == "muted")

    def levels(self) -> Mapping[str, int]:
        """How loud each is who sends a voice, by peer id; see `VoiceMixer.levels`."""
        return {} if self._hearing is None else self._hearing.mixer.levels()
