"""What the user sets of sound, and how sound stands. Pure data, which also travels by pickle."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from pica_client.errors import OptionError
from pica_client.voice.packet import FRAME_S, MAX_LEVEL

MAX_VOLUME: Final = 4.0
"""Largest volume of one voice or of all: 12 dB."""
MAX_DEVICE_NAME: Final = 256
NO_DEVICE: Final = "none"
"""The loudspeaker that makes no sound: voices are played all the same, and can be recorded."""
NO_LIBRARY: Final = "no sound system: SoundCard is not installed; install the extra voice"
NUM_MOMENTS: Final = 64
"""Moments of a voice that are known: 1.3 s, more than a loudspeaker's latency."""
HELD_S: Final = 0.5
"""A voice of which nothing was mixed for so long is not heard any more (chosen)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SoundSettings:
    """The user's settings of sound; an order of the panel that shows them."""

    microphone: str = ""
    """The microphone by its name; empty is the system's."""
    speaker: str = ""
    """The loudspeaker by its name; empty is the system's, ``none`` plays without a sound."""
    volume: float = 1.0
    """How loud all voices are, 0 to `MAX_VOLUME`; 1 is as sent."""
    is_stereo: bool = True
    """Whether each voice comes from its seat."""
    cleans: bool = True
    """Whether echo and noise are taken out of the microphone, and its loudness is evened out, where
    the extra ``echo`` is installed."""
    push_to_talk: bool = False
    """Whether the own voice is sent only while a key is held."""

    def __post_init__(self) -> None:
        for name in ("microphone", "speaker"):
            text = getattr(self, name)
            if not isinstance(text, str) or len(text) > MAX_DEVICE_NAME or not text.isprintable():
                raise OptionError(f"{name} is no text of up to {MAX_DEVICE_NAME} characters")
        if type(self.volume) not in (int, float) or not 0 <= self.volume <= MAX_VOLUME:
            raise OptionError(f"volume is {self.volume!r}; 0 to {MAX_VOLUME:g}")
        for name in ("is_stereo", "cleans", "push_to_talk"):
            if not isinstance(getattr(self, name), bool):
                raise OptionError(f"{name} is {getattr(self, name)!r}; true or false")


@dataclass(frozen=True, slots=True)
class DeviceState:
    """How a device stands, for people."""

    name: str = ""
    """What it is called; empty while none is open."""
    note: str = ""
    """What is wrong; empty: nothing."""
    latency_s: float = 0.0
    """What the device and its system say of themselves; 0 where they do not."""


Moment = tuple[float, float, float]
"""When 20 ms of a voice leave the loudspeaker, our clock, and when its first and its last sample
were captured, microseconds of the sender's."""


class HeardVoice:
    """Which moment of one voice is heard, by what was mixed of it."""

    def __init__(self) -> None:
        self._mixed: deque[Moment] = deque(maxlen=NUM_MOMENTS)

    def receive(self, moment: Moment) -> None:
        """Take what was mixed last."""
        self._mixed.append(moment)

    def at(self, now: float) -> int | None:
        """The moment that leaves the loudspeaker at `now`, microseconds of the sender's clock; None
        while there is none. What stands still, as in a stall, is heard at one moment."""
        for leaves_s, first, last in reversed(tuple(self._mixed)):  # another thread adds to it
            if leaves_s <= now:
                share = min((now - leaves_s) / FRAME_S, 2.0)
                return round(first + share * (last - first)) if now < leaves_s + HELD_S else None
        return None


@dataclass(frozen=True, kw_only=True, slots=True)
class SoundState:
    """How sound stands, every 20 ms."""

    speaker: DeviceState = field(default_factory=DeviceState)
    microphone: DeviceState = field(default_factory=DeviceState)
    speaker_level: int = MAX_LEVEL
    """How loud the last 20 ms were, see `voice.packet.level_of`."""
    microphone_level: int = MAX_LEVEL
    speakers: tuple[str, ...] = ()
    """Names of all, the default first."""
    microphones: tuple[str, ...] = ()
    cleaning: str = ""
    """Why the microphone cannot be cleaned of echo; empty: it can."""
    levels: Mapping[str, int] = field(default_factory=dict)
    """How loud each voice was, by peer id, see `voice.packet.level_of`."""
    moments: Mapping[str, Moment] = field(default_factory=dict)
    """What was just mixed of each voice that is heard, by peer id."""
    stats: Mapping[str, Any] = field(default_factory=dict)
    """See `VoiceMixer.stats`; twice a second."""

    @property
    def trouble(self) -> str:
        """What is wrong, for people; empty: nothing."""
        return self.speaker.note or self.microphone.note
