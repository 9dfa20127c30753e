"""The options of `pica view`, as they go from the command line to the window.

It imports little, so that the help comes at once.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from pica_client.avatars.upload import GiveAvatar
from pica_client.decode.request import DecodeChoice
from pica_client.errors import OptionError, check_ranges
from pica_client.render.seats import Layout
from pica_client.transport.connect import LinkConfig
from pica_protocol.limits import MAX_PEERS

BUDGET_SHARE = 0.6
"""Part of the time between two frames: the rest is for texts, the window system and recording
(measured with five people at 1280x720 on two cores: 0.6, 0.75 and 0.9 give 29, 28 and 25 images a
second, and heads in 0.50, 0.66 and 0.83 of the resolution)."""
SOFTWARE_FPS = 30.0
"""Faces come as often; more would take the processor from those who send and hear."""
DISPLAY_FPS = 60.0


def check_voice(source: str, voice: str | None) -> None:
    """Refuse a face that only a voice moves, where there is none.

    Raises:
        OptionError: Says what to add.
    """
    if source == "voice" and voice in (None, "none"):
        raise OptionError("source voice needs --voice mic or a WAV file")


def parse_size(text: str) -> tuple[int, int]:
    """`960x540` as columns and rows."""
    columns, _, rows = text.partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise OptionError(f"size is {text!r}; write COLUMNSxROWS, such as 960x540")
    size = int(columns), int(rows)
    if not all(16 <= length <= 8192 for length in size):
        raise OptionError(f"size is {text}; 16 to 8192 columns and rows are allowed")
    return size


@dataclass(frozen=True, kw_only=True, slots=True)
class JoinOptions:
    """Options of the commands that join a room."""

    url: str = ""
    """Address of the relay, ws:// or wss://; by default ws://127.0.0.1:8765, but pica view asks
    for it where there is a display."""
    redirect_hosts: tuple[str, ...] = ()
    """Other hosts that the relay may redirect to, with the token; over wss://, names of its domain
    need not be listed."""
    room: str = ""
    """Room to join, of letters, digits and _ . -; lobby by default."""
    name: str = ""
    """Name the others see."""
    give_avatar: GiveAvatar = "auto"
    """Give the own avatar's file to the relay, for those who do not have it; auto does, unless it
    ships with this package or there is a secret: the relay's operator can look at the file."""
    wait: bool = False
    """Wait for a relay that is not there yet, for --seconds if given, instead of giving up after 3
    seconds."""
    token_file: Path | None = None
    """File with the join token that the relay of --url wants, see pica token."""
    secret_file: Path | None = None
    """File with the room secret, from pica secret: encrypts end to end, see docs/privacy.md."""

    def link(self, *, seconds: float, **chosen: Any) -> LinkConfig:
        """The connection that is asked for.

        Args:
            seconds: How long the command runs, 0 is for ever; as long as that it waits for a relay,
                if it is to wait.
            chosen: Fields of `LinkConfig` that go before these options.
        """
        names = ("url", "redirect_hosts", "room", "name", "token_file", "secret_file")
        given: dict[str, Any] = {each: found for each in names if (found := getattr(self, each))}
        if self.wait:
            given["connect_timeout_s"] = seconds or None
        return LinkConfig(**(given | chosen))


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewOptions:
    """Options of `pica view`."""

    link: str = field(default="", kw_only=False)
    """An invite link, https://HOST/ROOM, as `pica token --link` prints it: it fills in the form, or
    says where to go where there is none."""
    join: Annotated[JoinOptions, Parameter(name="*")] = field(default_factory=JoinOptions)
    send: str | None = None
    """Send your own face as well: a source as in pica send; none only watches, the default with
    --url. A participant who joins by the form sends performance:talk if nothing else is named
    here. M mutes the face."""
    own_avatar: str | None = None
    """Avatar of your own face: a shipped one by its name, or a .pica file; by default a shipped
    one that goes by the name."""
    layout: Layout | None = None
    """How people sit: line, table or grid; L goes through them. By default as it was left."""
    voice: str | None = None
    """Whose voice is sent: mic, the system's microphone; mic:NAME; or what pica send takes;
    none by default, but mic where a form asks, which can be changed there."""
    speaker: str = ""
    """Loudspeaker by its name; none plays without a sound; by default the system's."""
    clean: bool | None = None
    """Take echo and noise out of the microphone, and even out how loud it is, where the extra echo
    is installed; by default as it was left, which is yes at first."""
    size: str | None = None
    """Columns x rows of the window or picture; by default as the window was left, or 960x540."""
    headless: bool = False
    """Draw without a window."""
    record: Path | None = None
    """Record into this MP4 file, which must not be there yet."""
    camera: Path | None = None
    """Give the picture to this device of v4l2loopback, such as /dev/video10, as a camera for other
    programs; Linux alone, untested on a device."""
    max_fps: float | None = None
    """Draw at most so many images a second; by default 60, and 30 where it is drawn in software."""
    decode: DecodeChoice = "auto"
    """Where faces are decoded: gpu, in shaders; cpu, by ONNX Runtime; auto takes the GPU where it
    is not drawn in software."""
    png: Path | None = None
    """Write the last image into this PNG file."""
    avatar: str | None = None
    """Further avatar files, separated by commas, for peers whose avatar neither ships nor is at the
    relay."""
    seconds: float = 0.0
    """How long to look; 0 is until the window is closed, or Ctrl-C."""
    expect: int = 0
    """Begin to draw once so many peers are seen."""

    def __post_init__(self) -> None:
        if self.size is not None:
            parse_size(self.size)
        if self.max_fps is not None:
            check_ranges(self, max_fps=(1, 1000))
        if not self.seconds >= 0:
            raise OptionError(f"seconds is {self.seconds:g}; 0 (for ever) or more is allowed")
        if not 0 <= self.expect < MAX_PEERS:
            raise OptionError(f"expect is {self.expect}; 0 to {MAX_PEERS - 1} is allowed")
