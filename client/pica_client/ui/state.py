"""What the user wants: the preferences, which one small file keeps, and the state of this call; and
all that its panels may show, as one read-only `CallView` a frame.

Panels and keys write into one `ViewState`; the rest of the viewer follows it. A panel is a function
of both, which draws with stock ImGui and `widgets`, and notes in the state what the user asks for.
A damaged file is reported once, and defaults are taken. No secret is in the file: the last address
is kept without user, password or query, tokens are not kept at all.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Final, Literal
from urllib.parse import urlsplit, urlunsplit

from pica_client.call.roster import Member
from pica_client.call.status import CallStatus
from pica_client.publish import DEFAULT_SOURCE
from pica_client.render.scene import Rect
from pica_client.render.seats import LAYOUTS, Layout
from pica_client.render.views import ViewState as Orbit
from pica_client.system import make_private, say
from pica_client.transport.connect import DEFAULT_ROOM, DEFAULT_URL
from pica_client.ui.widgets import Tone
from pica_client.voice.sound.settings import SoundSettings, SoundState
from pica_core.files import FOLDERS, replacing
from pica_protocol.messages import Peer

Sent = Literal["none", "sent", "muted"]
"""What becomes of the user's own face or voice; none: there is none to send."""
Side = Literal["none", "help", "participants", "settings"]
"""What stands in the panel at the right."""
SCALES: Final = (0.8, 1.0, 1.25, 1.5)
"""Sizes of type and buttons to choose from."""
CHOICES: Final[dict[str, tuple[Any, ...]]] = {"layout": LAYOUTS, "scale": SCALES}
LAYOUT_TITLES: Final[dict[Layout, str]] = {"line": "Line", "table": "Round table", "grid": "Grid"}


@dataclass(kw_only=True, slots=True)
class Preferences:
    """What is kept from call to call."""

    url: str = DEFAULT_URL
    """The relay of the last call."""
    room: str = DEFAULT_ROOM
    name: str = ""
    """The user's name in the call."""
    avatar: str = ""
    """The user's own, by name or file; empty takes one by the name."""
    source: str = DEFAULT_SOURCE
    """What plays the user's face; empty only watches."""
    voice: str = "mic"
    """Whose voice is sent, for `voice.source.open_voice`."""
    secret_file: str = ""
    """File with the room secret; the secret itself is not kept."""
    layout: Layout = "line"
    scale: float = 1.0
    """Size of type and buttons, one of `SCALES`."""
    shows_self: bool = True
    """Show the own face in a corner, while one is sent."""
    sound: SoundSettings = field(default_factory=SoundSettings)
    window_size: tuple[int, int] = (960, 540)
    """Columns and rows, in the screen's units."""

    def __post_init__(self) -> None:
        for name, allowed in CHOICES.items():
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name} is {getattr(self, name)!r}; {allowed} are allowed")
        width, height = self.window_size
        self.window_size = min(max(width, 160), 8192), min(max(height, 160), 8192)


@dataclass(kw_only=True, slots=True)
class ViewState(Preferences):
    """The preferences, and what holds for this call alone."""

    token: str = field(default="", repr=False)
    wants_close: bool = False
    orbit: Orbit = field(default_factory=Orbit)
    """From where the people are seen."""
    pinned: int | None = None
    """The place of the person who fills the picture, also while that one is away."""
    volumes: dict[int, float] = field(default_factory=dict)
    """How loud people are here, by place; others are as loud as sent."""
    barred: dict[str, str] = field(default_factory=dict)
    """Names of those whom this admin has barred, by identity."""
    side: Side = "none"
    asks_to_leave: bool = False
    own_face: Sent = "none"
    own_voice: Sent = "none"
    is_talking: bool = False
    """Whether the key to talk is held."""
    is_recording: bool = False
    requests: list[Any] = field(default_factory=list)
    """What keys and panels ask for and was not done yet: `actions.Request`."""

    @property
    def is_heard(self) -> bool:
        """Return True if the own voice is to be sent now."""
        return self.own_voice == "sent" and (self.is_talking or not self.sound.push_to_talk)

    def enter(self) -> None:
        """Begin a stay in a room; forget what held for the people and the panels of another."""
        self.orbit, self.pinned, self.side = Orbit(), None, "none"
        self.volumes, self.barred = {}, {}
        self.wants_close = self.asks_to_leave = False
        self.is_talking = self.is_recording = False

    def pin(self, place: int | None) -> None:
        """Pin a participant, or let go of the one who is pinned."""
        if place is not None:
            self.pinned = None if self.pinned == place else place
            self.orbit = Orbit()

    def seat(self, layout: Layout) -> str:
        """Choose a layout; return a notice for the user."""
        self.layout, self.pinned, self.orbit = layout, None, Orbit()
        return f"Layout: {LAYOUT_TITLES[layout]}"


class PreferencesFile:
    """The file of one user.

    Args:
        folder: Where it is; by default this user's for settings.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.path = (FOLDERS.user_config_path if folder is None else folder) / "preferences.json"

    def load(self) -> ViewState:
        """What is in the file; defaults if there is none, or none that can be used."""
        try:
            content = json.loads(self.path.read_bytes())
            sound = SoundSettings(**_known(SoundSettings, content.get("sound", {})))
            return ViewState(**_known(Preferences, content) | {"sound": sound})
        except FileNotFoundError:
            return ViewState()
        except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
            reason = getattr(error, "strerror", None) or error
            say(f"{self.path}: preferences cannot be used, taking defaults: {reason}")
            return ViewState()

    def save(self, state: ViewState) -> None:
        """Replace the file, whole or not at all. When it cannot be written, the user is told and
        the call goes on."""
        kept = {each.name: getattr(state, each.name) for each in fields(Preferences)}
        kept |= {"url": _without_secrets(state.url), "sound": asdict(state.sound)}
        try:
            make_private(self.path.parent)
            with replacing(self.path) as unfinished:
                unfinished.touch(0o600)
                unfinished.write_text(json.dumps(kept, indent=2) + "\n")
        except OSError as error:
            reason = getattr(error, "strerror", None) or error
            say(f"{self.path}: preferences cannot be kept: {reason}")


def _without_secrets(url: str) -> str:
    """An address without user, password, query and fragment: there might be a token in them."""
    try:
        parts = urlsplit(url)
        host = parts.netloc.rpartition("@")[2]
        return urlunsplit((parts.scheme, host, parts.path, "", ""))
    except ValueError:
        return ""


def _known(kind: type, content: dict[str, Any]) -> dict[str, Any]:
    """The values of a dataclass, each as the type of its default, or ValueError or TypeError; what
    else is there is left out."""
    usual = asdict(kind())
    return {name: type(usual[name])(content[name]) for name in usual if name in content}


UNKNOWN: Final = Member(peer=Peer(peer_id="unknown", name="unknown"))
"""Stands for a participant whom the list does not have yet."""
NOTICE_S: Final = 6.0
"""How long a notice stands (chosen: a line of twenty words is read)."""
MAX_NOTICES: Final = 3
"""Shown at once; one more drops the oldest."""


Line = tuple[str, Tone]
"""Something that is said, and how loud."""


class NoticeBoard:
    """Keeps the notices that are shown."""

    def __init__(self) -> None:
        self._notices: list[tuple[Line, float]] = []

    def add(self, notice: Line, now: float) -> None:
        """Show a notice from `now` on, seconds; the same text again only stays longer."""
        others = [each for each in self._notices if each[0] != notice]
        self._notices = [*others, (notice, now + NOTICE_S)][-MAX_NOTICES:]

    def shown(self, now: float) -> tuple[Line, ...]:
        """Return the notices of this moment, the oldest first."""
        self._notices = [each for each in self._notices if now < each[1]]
        return tuple(notice for notice, _ in self._notices)


@dataclass(frozen=True, kw_only=True, slots=True)
class PersonView:
    """All that is shown of one participant."""

    peer_id: str
    name: str
    remark: str = ""
    """What is wrong with the avatar, the face or the connection; empty when all is well."""
    is_speaking: bool = False
    label: Rect | None = None
    """The part of the surface that the name may fill, from its upper edge on; None: nowhere."""
    member: Member = UNKNOWN
    """As of the last look at the room."""


@dataclass(frozen=True, kw_only=True, slots=True)
class OwnFaceView:
    """What is shown of the user's own face."""

    texture: int | None = None
    """What the others see, as a number of the surface; None before there is a picture."""
    source: str = ""
    """What plays it."""
    is_seen: bool | None = None
    """Whether its tracker sees a face; None without a tracker."""
    camera: int | None = None
    """What its camera sees, as a number of the surface."""
    aspect: float = 1.0
    """Width by height of that."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CallView:
    """One frame of a call."""

    people: tuple[PersonView, ...] = ()
    """All participants with a face, in the order of their seats."""
    status: CallStatus = field(default_factory=CallStatus)
    notices: tuple[Line, ...] = ()
    """What was just done, and what just happened, the oldest first."""
    has_pointer: bool = True
    """There is a window with a pointer, and so a control bar."""
    own: OwnFaceView = field(default_factory=OwnFaceView)
    sound: SoundState | None = None
    """How sound stands; None: there is none."""


Panel = Callable[[ViewState, CallView], None]
