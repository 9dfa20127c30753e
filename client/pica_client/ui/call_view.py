"""All that the panels of a call may show, as one read-only value a frame. Pure.

A panel is a function of the user's state and a `CallView`. It draws with
stock ImGui and `widgets`, writes settings into the state, and notes there what else the user asks
for:

    def leave_question(state: ViewState, call: CallView) -> None:
        ...
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from pica_client.call.roster import Member
from pica_client.call.status import CallStatus
from pica_client.render.scene import Rect
from pica_client.ui.state import ViewState
from pica_client.ui.widgets import Tone
from pica_client.voice.sound.settings import SoundState
from pica_protocol.messages import Peer

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
