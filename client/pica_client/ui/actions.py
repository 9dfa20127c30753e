"""What keys, buttons and the mouse do: one table, `ACTIONS`, that all of them and the help read.

Keys and panels note in the state what they ask for. An action changes the state, or is a request to
the owner of files and windows:

    keyboard(state)
    control_bar(state, call)
    for request in settle(state):
        ...
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final, Literal

from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from pica_client.render.seats import LAYOUTS
from pica_client.render.views import ViewState as Orbit
from pica_client.ui.state import Side, ViewState
from pica_client.ui.widgets import Tone
from pica_protocol.messages import Moderation

CLICK_PX = 5.0
"""A press that moves less than this before it is let go is a click."""
TALK_KEY = imgui.Key.space
"""Held to be heard, where the settings say so."""


class Action(Enum):
    """What a key or a button asks for."""

    MUTE_VOICE = auto()
    MUTE_FACE = auto()
    NEXT_LAYOUT = auto()
    RESET_VIEW = auto()
    RECORD = auto()
    PARTICIPANTS = auto()
    SETTINGS = auto()
    HELP = auto()
    FULL_SCREEN = auto()
    CLOSE = auto()
    """Close what is open, or ask whether to leave."""
    COPY_INVITATION = auto()


Request = Action | Moderation | str
"""What panels and keys ask for; a string is shown to the user for a few seconds."""
Look = tuple[str, str, Tone]
"""A button's icon, tooltip and tone."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One line of the table."""

    keys: tuple[imgui.Key, ...] = ()
    title: str = ""
    """What the help says of it; empty is not shown there."""
    change: Callable[[ViewState], str | None] | None = None
    """Changes the state, and may tell the user something; None: the viewer carries it out."""
    toggle: tuple[str, object, object] | None = None
    """A field of the state with its values while this is on, and while it is off."""
    is_request: bool = False
    """The viewer carries it out, and its toggle only follows."""
    needs: Literal["", "face", "voice"] = ""
    """What must be sent for it."""
    group: int = 0
    """Where its button stands in the control bar."""
    off: Look | None = None
    """Its button in the control bar; None: it has none."""
    on: Look | None = None
    """The button while the toggle is on; None: as before, in the accent's colour."""

    def is_possible(self, state: ViewState) -> bool:
        """Return True if what the action needs is being sent."""
        return not self.needs or getattr(state, f"own_{self.needs}") != "none"

    def look(self, state: ViewState) -> Look:
        """Return how its button looks now."""
        assert self.off is not None
        if self.toggle is None or getattr(state, self.toggle[0]) != self.toggle[1]:
            return self.off
        return self.on or (*self.off[:2], "accent")

    @property
    def key_names(self) -> tuple[str, ...]:
        """The names of its keys."""
        return tuple(dict.fromkeys(imgui.get_key_name(k) for k in self.keys))


def _reset_view(state: ViewState) -> None:
    state.orbit, state.pinned = Orbit(), None


def _next_layout(state: ViewState) -> str:
    return state.seat(LAYOUTS[(LAYOUTS.index(state.layout) + 1) % len(LAYOUTS)])


def _panel(side: Side, icon: str, *keys: imgui.Key) -> Row:
    """A panel at the right, opened and closed."""
    toggle = ("side", side, "none")
    return Row(keys=keys, title=side, toggle=toggle, group=2, off=(icon, side.title(), "plain"))


def _close(state: ViewState) -> None:
    if state.asks_to_leave:
        state.asks_to_leave = False
    elif state.side != "none":
        state.side = "none"
    else:
        state.asks_to_leave = True


_KEY = imgui.Key
ACTIONS: Final[dict[Action, Row]] = {
    Action.NEXT_LAYOUT: Row(
        keys=(_KEY.l,),
        title="next layout",
        change=_next_layout,
        group=1,
        off=(icons.ICON_FA_TABLE_CELLS_LARGE, "Next layout", "plain"),
    ),
    Action.RESET_VIEW: Row(keys=(_KEY.r,), title="reset view and pin", change=_reset_view),
    Action.MUTE_VOICE: Row(
        keys=(_KEY.t,),
        title="mute own voice",
        toggle=("own_voice", "muted", "sent"),
        needs="voice",
        off=(icons.ICON_FA_MICROPHONE, "Mute your voice", "plain"),
        on=(icons.ICON_FA_MICROPHONE_SLASH, "Let yourself be heard", "alert"),
    ),
    Action.MUTE_FACE: Row(
        keys=(_KEY.m,),
        title="mute own face",
        toggle=("own_face", "muted", "sent"),
        needs="face",
        off=(icons.ICON_FA_FACE_SMILE, "Hide your face", "plain"),
        on=(icons.ICON_FA_EYE_SLASH, "Show your face", "alert"),
    ),
    Action.PARTICIPANTS: _panel("participants", icons.ICON_FA_USER_GROUP, _KEY.u),
    Action.RECORD: Row(
        keys=(_KEY.v,),
        title="start or stop recording",
        toggle=("is_recording", True, False),
        is_request=True,
        group=1,
        off=(icons.ICON_FA_CIRCLE, "Record", "plain"),
        on=(icons.ICON_FA_SQUARE, "Stop recording", "alert"),
    ),
    Action.FULL_SCREEN: Row(keys=(_KEY.f11,), title="full screen"),
    Action.SETTINGS: _panel("settings", icons.ICON_FA_GEAR, _KEY.o),
    Action.HELP: _panel("help", icons.ICON_FA_CIRCLE_QUESTION, _KEY.h, _KEY.f1),
    Action.CLOSE: Row(
        keys=(_KEY.escape, _KEY.q),
        title="close, or leave",
        change=_close,
        group=3,
        off=(icons.ICON_FA_PHONE_SLASH, "Leave the call", "alert"),
    ),
}
"""All that keys and buttons do; actions that are not here have a button in one panel alone."""


def settle(state: ViewState) -> list[Request]:
    """Change the state as was asked; return what is left for others to carry out."""
    rest = [_apply(each, state) for each in state.requests]
    state.requests.clear()
    return [each for each in rest if each is not None]


def _apply(request: Request, state: ViewState) -> Request | None:
    row = ACTIONS.get(request) if isinstance(request, Action) else None
    if row is None:
        return request
    if not row.is_possible(state):
        return None
    if row.toggle is not None and not row.is_request:
        name, on, off = row.toggle
        setattr(state, name, off if getattr(state, name) == on else on)
        return None
    return request if row.change is None else row.change(state)


def help_lines(state: ViewState) -> tuple[tuple[str, str], ...]:
    """Return the keys and what they do, for people."""
    keys = (
        (", ".join(row.key_names), row.title)
        for row in ACTIONS.values()
        if row.title and row.is_possible(state)
    )
    return (
        ("drag", "look around"),
        ("wheel", "come closer, go back"),
        ("click", "pin a participant, or not"),
        (imgui.get_key_name(TALK_KEY), "hold to talk, if set so"),
        *keys,
    )


def keyboard(state: ViewState) -> None:
    """Read the keys of this frame, unless a text is being typed."""
    io = imgui.get_io()
    is_typed = io.want_text_input
    state.is_talking = imgui.is_key_down(TALK_KEY) and not is_typed
    if io.key_ctrl or io.key_super:
        return  # the desktop's own
    if state.asks_to_leave and not is_typed and imgui.is_key_pressed(_KEY.enter, repeat=False):
        state.wants_close = True
    for action, row in ACTIONS.items():
        for key in row.keys:
            if (key == _KEY.escape or not is_typed) and imgui.is_key_pressed(key, repeat=False):
                state.requests.append(action)


def mouse(state: ViewState, pick: Callable[[float, float], int | None]) -> None:
    """Let the mouse turn the view and pin people, unless it is on a panel.

    Args:
        pick: Returns the place of the participant at a point of the picture, y down.
    """
    io = imgui.get_io()
    if io.want_capture_mouse:
        return
    state.orbit = state.orbit.zoomed(io.mouse_wheel)
    if imgui.is_mouse_dragging(0, CLICK_PX):
        right, down = imgui.get_mouse_drag_delta(0, CLICK_PX)
        imgui.reset_mouse_drag_delta(0)
        state.orbit = state.orbit.orbited(right, down)
    if imgui.is_mouse_released(0) and io.mouse_drag_max_distance_sqr[0] < CLICK_PX**2:
        state.pin(pick(*io.mouse_pos))
