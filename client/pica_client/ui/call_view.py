"""All that the panels of a call may show, as one read-only value a frame. Pure.

A panel is a function of the user's state, a `CallView` and the picture's metrics. It draws with the
widgets of `surface`, writes settings into the state, and returns what else the user asked for:

    def leave_question(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
        ...
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from pica_client.call.faces import FaceStatus
from pica_client.call.status import AvatarFigures, CallStatus, PeerStatus
from pica_client.publish.face_desk import Seen
from pica_client.render.scene import Rect
from pica_client.ui.actions import Request
from pica_client.ui.notice_board import Notice
from pica_client.ui.state import ViewState
from pica_client.ui.surface.theme import Metrics
from pica_client.voice.sound.settings import SoundState


@dataclass(frozen=True, kw_only=True, slots=True)
class PersonView:
    """All that is shown of one participant."""

    peer_id: str
    name: str
    status: FaceStatus = "live"
    note: str = ""
    """What is wrong with the stream or the avatar, for people."""
    is_speaking: bool = False
    is_voice_muted: bool = False
    label_px: Rect | None = None
    """The part of the picture that the name may fill, from its upper edge on; None for nowhere."""
    figures: AvatarFigures | None = None
    stream: PeerStatus = field(default_factory=PeerStatus)
    draw_ms: float | None = None
    """This head's share of the drawing time."""

    @property
    def remark(self) -> str:
        """What stands under the name; empty when all is well."""
        if self.note or self.status == "away":
            return self.note or "away"
        return "poor connection" if self.stream.quality == "poor" else ""


@dataclass(frozen=True, kw_only=True, slots=True)
class OwnFaceView:
    """What is shown of one's own face."""

    texture: int | None = None
    """What the others see, by the painter's number; None before there is a picture."""
    source: str = ""
    """What plays it."""
    seen: Seen | None = None
    """What its tracker sees; None where no tracker plays it."""
    camera: int | None = None
    """What its camera sees, by the painter's number."""


NOTHING = OwnFaceView()


@dataclass(frozen=True, kw_only=True, slots=True)
class CallView:
    """One frame of a call."""

    now: float
    people: tuple[PersonView, ...] = ()
    """Everybody who is there, in the order of their seats."""
    status: CallStatus = field(default_factory=CallStatus)
    notices: tuple[Notice, ...] = ()
    """What was just done, and what just happened, the oldest first."""
    shows_bar: bool = True
    """Whether the control bar is to be seen: the pointer moved a moment ago."""
    has_pointer: bool = True
    """Whether there is somebody to steer: a window."""
    own: OwnFaceView = NOTHING
    """One's own face, as others and as the tracker see it."""
    sound: SoundState | None = None
    """How sound stands; None: there is none."""
    figures: tuple[tuple[str, str], ...] = ()
    """Figures of the whole call, name and value."""


Panel = Callable[[ViewState, CallView, Metrics], list[Request]]
