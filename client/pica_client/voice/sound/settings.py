"""What the user sets of sound, and how sound stands. Pure data, which also travels by pickle."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from pica_client.voice.jitter_buffer import JitterBufferReport, Moment
from pica_client.voice.opus import MAX_LEVEL

MAX_VOLUME: Final = 4.0
"""Largest volume of one voice or of all: 12 dB."""
NO_DEVICE: Final = "none"
"""The loudspeaker that makes no sound: voices are played all the same, and can be recorded."""
NO_LIBRARY: Final = "no sound system: SoundCard is not installed; install the extra voice"


@dataclass(frozen=True, kw_only=True, slots=True)
class SoundSettings:
    """The user's settings of sound; an order of the panel that shows them."""

    microphone: str = ""
    """The microphone by its name; empty is the system's."""
    speaker: str = ""
    """The loudspeaker by its name; empty is the system's, ``none`` plays without a sound."""
    volume: float = 1.0
    """How loud all voices are, 0 to `MAX_VOLUME`; 1 is as sent."""
    cleans: bool = True
    """Whether echo and noise are taken out of the microphone, and its loudness is evened out, where
    the extra ``echo`` is installed."""
    push_to_talk: bool = False
    """Whether the own voice is sent only while a key is held."""

    def __post_init__(self) -> None:
        if not 0 <= self.volume <= MAX_VOLUME:
            raise ValueError(f"volume is {self.volume!r}; 0 to {MAX_VOLUME:g}")


@dataclass(frozen=True, slots=True)
class DeviceState:
    """How a device stands, for people."""

    name: str = ""
    """What it is called; empty while none is open."""
    note: str = ""
    """What is wrong; empty: nothing."""
    latency_s: float = 0.0
    """What the device and its system say of themselves; 0 where they do not."""


@dataclass(frozen=True, slots=True)
class MixedVoice:
    """One voice in the last 20 ms."""

    level: int
    """How loud it was, see `voice.opus.level_of`."""
    moment: Moment | None
    """None while nothing is heard of it."""
    report: JitterBufferReport


@dataclass(frozen=True, kw_only=True, slots=True)
class SoundState:
    """How sound stands, every 20 ms."""

    speaker: DeviceState = field(default_factory=DeviceState)
    microphone: DeviceState = field(default_factory=DeviceState)
    speaker_level: int = MAX_LEVEL
    """How loud the last 20 ms were, see `voice.opus.level_of`."""
    microphone_level: int = MAX_LEVEL
    speakers: tuple[str, ...] = ()
    """Names of all, the default first."""
    microphones: tuple[str, ...] = ()
    cleaning: str = ""
    """Why the microphone cannot be cleaned of echo; empty: it can."""
    voices: Mapping[str, MixedVoice] = field(default_factory=dict)
    """By peer id."""

    @property
    def trouble(self) -> str:
        """What is wrong, for people; empty: nothing."""
        return self.speaker.note or self.microphone.note
