"""What the user sets once and finds again: how the surface looks, and what it may cost. Pure."""

from dataclasses import dataclass
from typing import Final, Literal, get_args

from pica_client.errors import OptionError

Mode = Literal["dark", "light"]
SCALES: Final = (0.8, 1.0, 1.25, 1.5)
"""Sizes of type and buttons to choose from."""
MIN_DETAIL: Final = 0.1


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """The user's settings of a call; an order of the panel that shows them."""

    mode: Mode = "dark"
    scale: float = 1.0
    """Size of type and buttons, one of `SCALES`."""
    shows_self: bool = True
    """Whether one's own face is shown in a corner, while one is sent."""
    detail: float = 1.0
    """Part of the time for a frame that decoding and drawing may take, `MIN_DETAIL` to 1."""

    def __post_init__(self) -> None:
        if self.mode not in get_args(Mode):
            raise OptionError(f"mode is {self.mode!r}; dark or light")
        if self.scale not in SCALES:
            raise OptionError(f"scale is {self.scale!r}; one of {SCALES}")
        if not isinstance(self.shows_self, bool):
            raise OptionError(f"shows_self is {self.shows_self!r}; true or false")
        if type(self.detail) not in (int, float) or not MIN_DETAIL <= self.detail <= 1:
            raise OptionError(f"detail is {self.detail!r}; {MIN_DETAIL:g} to 1")


@dataclass(frozen=True, kw_only=True, slots=True)
class OwnChoice:
    """Who one is in a call, and what plays the face; an order of the panel that shows it."""

    name: str = ""
    avatar: str = ""
    """A name or a file; empty goes by the name."""
    source: str = ""
    """What plays it, for `sources.open_source`; empty only watches."""
    voice: str = "none"
    """Whose voice is sent, for `voice.source.open_voice`."""
