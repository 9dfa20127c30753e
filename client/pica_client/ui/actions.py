"""What keys, buttons and the mouse do: one table, `ACTIONS`, that all of them and the help read.

An action changes the state, or is a request to the owner of files and windows:

    controls = Controls(ViewState())
    controls.receive(KeyPressed("L"), places=(0, 1))
    controls.state.layout, controls.take_requests()
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final, Literal

from pica_client.render.seats import LAYOUTS
from pica_client.render.views import ViewState as Orbit
from pica_client.ui import events
from pica_client.ui.state import OwnFace, Side, ViewState
from pica_client.ui.surface import icons
from pica_client.ui.surface.theme import Tone
from pica_protocol.messages import Moderation

CLICK_PX = 5.0
"""A press that moves less than this before it is let go is a click."""
KEY_ORBIT_PX = 40.0
"""An arrow key drags the view by so many pixels."""
MAX_PINNED_BY_KEY = 9
TALK_KEY = "Space"
"""Held to be heard, where the settings say so."""
NO_FACE = "You show no face: choose a face source in the settings (--send)"
NO_VOICE = "You send no voice: choose a microphone in the settings (--voice mic)"


class Action(Enum):
    """What a key or a button asks for."""

    MUTE_VOICE = auto()
    MUTE_FACE = auto()
    FREEZE_FACE = auto()
    CALIBRATE = auto()
    NEXT_LAYOUT = auto()
    RESET_VIEW = auto()
    UNPIN = auto()
    COME_CLOSER = auto()
    GO_BACK = auto()
    LOOK_LEFT = auto()
    LOOK_RIGHT = auto()
    LOOK_UP = auto()
    LOOK_DOWN = auto()
    SCREENSHOT = auto()
    RECORD = auto()
    PARTICIPANTS = auto()
    SETTINGS = auto()
    HELP = auto()
    STATISTICS = auto()
    FULL_SCREEN = auto()
    CLOSE = auto()
    """Close what is open, or ask whether to leave."""
    LEAVE = auto()
    REJOIN = auto()
    """Leave for a moment and join again with the identity in the settings."""
    TEST_SOUND = auto()
    COPY_INVITATION = auto()


Request = Action | Moderation | str
"""What panels and keys ask for; a string is said to the user for a few seconds."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Button:
    """A button of the control bar; some look otherwise while what they do is on."""

    group: int
    icon: str
    tip: str
    tone: Tone = "plain"
    is_on: Callable[[ViewState], bool] = lambda state: False
    icon_on: str = ""
    tip_on: str = ""
    tone_on: Tone = "accent"

    def look(self, state: ViewState) -> tuple[str, str, Tone]:
        """Its icon, its tooltip and its tone now."""
        if self.is_on(state):
            return self.icon_on or self.icon, self.tip_on or self.tip, self.tone_on
        return self.icon, self.tip, self.tone


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One line of the table."""

    keys: tuple[str, ...] = ()
    title: str = ""
    """What the help says of it; empty is not shown there."""
    change: Callable[[ViewState], str | None] | None = None
    """Changes the state, and may say something to the user; None: the viewer carries it out."""
    repeats: bool = False
    """Whether holding the key does it again."""
    needs: Literal["", "face", "voice"] = ""
    """What must be sent for it."""
    button: Button | None = None


def _set(**values: object) -> Callable[[ViewState], None]:
    def change(state: ViewState) -> None:
        for name, value in values.items():
            setattr(state, name, value)

    return change


def _own_face(wanted: OwnFace) -> Callable[[ViewState], None]:
    """Between this and simply being sent."""

    def change(state: ViewState) -> None:
        state.own_face = "sent" if state.own_face == wanted else wanted

    return change


def _side(wanted: Side) -> Callable[[ViewState], None]:
    """Open a panel at the right, or close it."""

    def change(state: ViewState) -> None:
        state.side = "none" if state.side == wanted else wanted

    return change


def _look(right: float, down: float) -> Callable[[ViewState], None]:
    def change(state: ViewState) -> None:
        state.orbit = state.orbit.orbited(right * KEY_ORBIT_PX, down * KEY_ORBIT_PX, state.limits)

    return change


def _zoom(steps: float) -> Callable[[ViewState], None]:
    def change(state: ViewState) -> None:
        state.orbit = state.orbit.zoomed(steps)

    return change


def _mute_voice(state: ViewState) -> None:
    state.own_voice = "sent" if state.own_voice == "muted" else "muted"


def _toggle_statistics(state: ViewState) -> None:
    state.show_statistics = not state.show_statistics


def _reset_view(state: ViewState) -> None:
    state.orbit, state.pinned = Orbit(), None


def _next_layout(state: ViewState) -> str:
    """Take the one after what is shown that there is room for, if there is another."""
    shown = state.layout if state.layout in state.layouts else "grid"
    after = LAYOUTS.index(shown) + 1
    others = (*LAYOUTS[after:], *LAYOUTS[: after - 1])
    return state.seat(next((each for each in others if each in state.layouts), state.layout))


def _close(state: ViewState) -> None:
    if state.asks_to_leave:
        state.asks_to_leave = False
    elif state.side != "none":
        state.side = "none"
    else:
        state.asks_to_leave = True


ACTIONS: Final[dict[Action, Row]] = {
    Action.NEXT_LAYOUT: Row(
        keys=("L",),
        title="next layout",
        change=_next_layout,
        button=Button(group=1, icon=icons.LAYOUT, tip="Next layout"),
    ),
    Action.RESET_VIEW: Row(keys=("R",), title="reset view and pin", change=_reset_view),
    Action.UNPIN: Row(keys=("0",), title="unpin", change=_set(pinned=None)),
    Action.COME_CLOSER: Row(keys=("+", "="), title="come closer", change=_zoom(1), repeats=True),
    Action.GO_BACK: Row(keys=("-",), title="go back", change=_zoom(-1), repeats=True),
    Action.LOOK_LEFT: Row(keys=("Left",), change=_look(1, 0), repeats=True),
    Action.LOOK_RIGHT: Row(keys=("Right",), change=_look(-1, 0), repeats=True),
    Action.LOOK_UP: Row(keys=("Up",), change=_look(0, 1), repeats=True),
    Action.LOOK_DOWN: Row(keys=("Down",), change=_look(0, -1), repeats=True),
    Action.MUTE_VOICE: Row(
        keys=("T",),
        title="mute own voice",
        change=_mute_voice,
        needs="voice",
        button=Button(
            group=0,
            icon=icons.VOICE,
            tip="Mute your voice",
            is_on=lambda state: state.own_voice == "muted",
            icon_on=icons.VOICE_OFF,
            tip_on="Let yourself be heard",
            tone_on="alert",
        ),
    ),
    Action.MUTE_FACE: Row(
        keys=("M",),
        title="mute own face",
        change=_own_face("muted"),
        needs="face",
        button=Button(
            group=0,
            icon=icons.FACE,
            tip="Hide your face",
            is_on=lambda state: state.own_face == "muted",
            icon_on=icons.FACE_OFF,
            tip_on="Show your face",
            tone_on="alert",
        ),
    ),
    Action.FREEZE_FACE: Row(
        keys=("F",),
        title="freeze own face",
        change=_own_face("frozen"),
        needs="face",
        button=Button(
            group=0,
            icon=icons.FREEZE,
            tip="Freeze your face",
            is_on=lambda state: state.own_face == "frozen",
            tip_on="Let your face move",
        ),
    ),
    Action.CALIBRATE: Row(keys=("K",), title="calibrate the tracker", needs="face"),
    Action.PARTICIPANTS: Row(
        keys=("U",),
        title="participants",
        change=_side("participants"),
        button=Button(
            group=2,
            icon=icons.PEOPLE,
            tip="Participants",
            is_on=lambda state: state.side == "participants",
        ),
    ),
    Action.STATISTICS: Row(keys=("S",), title="statistics", change=_toggle_statistics),
    Action.SCREENSHOT: Row(
        keys=("P",),
        title="picture into a file",
        button=Button(group=1, icon=icons.PICTURE, tip="Take a picture"),
    ),
    Action.RECORD: Row(
        keys=("V",),
        title="start or stop recording",
        button=Button(
            group=1,
            icon=icons.RECORD,
            tip="Record",
            is_on=lambda state: state.is_recording,
            icon_on=icons.STOP,
            tip_on="Stop recording",
            tone_on="alert",
        ),
    ),
    Action.FULL_SCREEN: Row(keys=("F11",), title="full screen"),
    Action.SETTINGS: Row(
        keys=("O",),
        title="settings",
        change=_side("settings"),
        button=Button(
            group=2,
            icon=icons.SETTINGS,
            tip="Settings",
            is_on=lambda state: state.side == "settings",
        ),
    ),
    Action.HELP: Row(
        keys=("H", "F1"),
        title="this help",
        change=_side("help"),
        button=Button(
            group=2, icon=icons.HELP, tip="Help", is_on=lambda state: state.side == "help"
        ),
    ),
    Action.CLOSE: Row(
        keys=("Escape", "Q"),
        title="close, or leave",
        change=_close,
        button=Button(group=3, icon=icons.LEAVE, tip="Leave the call", tone="alert"),
    ),
    Action.LEAVE: Row(change=_set(wants_close=True)),
}
"""All that keys and buttons do; actions that are not here have a button in one panel alone."""
_BY_KEY = {key: action for action, row in ACTIONS.items() for key in row.keys}


def key_of(action: Action) -> str:
    """The key that a tooltip names; empty if there is none."""
    return ACTIONS[action].keys[0] if ACTIONS[action].keys else ""


def is_possible(row: Row, state: ViewState) -> bool:
    """Return True if what an action needs is being sent."""
    sent = {"face": state.own_face, "voice": state.own_voice}
    return sent.get(row.needs, "sent") != "none"


def help_lines(state: ViewState) -> tuple[tuple[str, str], ...]:
    """The keys and what they do, for people."""
    keys = (
        (", ".join(row.keys), row.title)
        for row in ACTIONS.values()
        if row.title and (row.needs != "face" or is_possible(row, state))
    )
    return (
        ("drag, arrows", "look around"),
        ("wheel", "come closer, go back"),
        (f"click, 1 to {MAX_PINNED_BY_KEY}", "pin a participant, or not"),
        (TALK_KEY, "hold to talk, if set so"),
        *keys,
    )


class Controls:
    """Turns input into changes of the state, and into requests."""

    def __init__(self, state: ViewState | None = None) -> None:
        self.state = state or ViewState()
        self._requests: list[Request] = []
        self._pressed_at: tuple[float, float] | None = None
        self._pointer = (0.0, 0.0)
        self._is_drag = False

    def receive(
        self,
        event: events.InputEvent,
        *,
        places: Sequence[int] = (),
        pick: Callable[[float, float], int | None] = lambda x_px, y_px: None,
    ) -> None:
        """Take one event that is not for the surface.

        Args:
            places: Of everybody who is there, from left to right: number keys pin them.
            pick: Whose place it is that a point of the picture shows, pixels, y down.
        """
        state = self.state
        match event:
            case events.KeyPressed():
                self._press_key(event, places)
            case events.KeyReleased(key=key) if key == TALK_KEY:
                state.is_talking = False
            case events.Scrolled(steps=steps) if math.isfinite(steps):
                state.orbit = state.orbit.zoomed(steps)
            case events.MousePressed(x_px=x, y_px=y, button=0):
                self._pressed_at = self._pointer = (x, y)
                self._is_drag = False
            case events.MouseMoved(x_px=x, y_px=y):
                self._move(x, y)
            case events.MouseReleased(x_px=x, y_px=y, button=0):
                if self._pressed_at is not None and not self._is_drag:
                    state.pin(pick(x, y))
                self._pressed_at = None
            case events.CloseWanted():
                state.wants_close = True
            case _:
                pass

    def obey(self, request: Request) -> None:
        """Take what a key or a panel asks for."""
        row = ACTIONS.get(request) if isinstance(request, Action) else None
        if row is not None and not is_possible(row, self.state):
            request, row = NO_FACE if row.needs == "face" else NO_VOICE, None
        if row is None or row.change is None:
            self._requests.append(request)
        elif said := row.change(self.state):
            self._requests.append(said)

    def take_requests(self) -> list[Request]:
        """What the owner of files and windows has to do since the last call."""
        requests, self._requests = self._requests, []
        return requests

    def _press_key(self, event: events.KeyPressed, places: Sequence[int]) -> None:
        key, state = event.key, self.state
        if event.has_control:
            return  # the desktop's own
        if key == TALK_KEY:
            state.is_talking = True
        elif key.isdecimal() and key != "0":
            if not event.is_repeat and int(key) <= len(places):
                state.pin(places[int(key) - 1])
        elif state.asks_to_leave and key == "Enter":
            state.wants_close = True
        elif key in _BY_KEY and (not event.is_repeat or ACTIONS[_BY_KEY[key]].repeats):
            self.obey(_BY_KEY[key])

    def _move(self, x: float, y: float) -> None:
        if self._pressed_at is None:
            return
        if not self._is_drag and math.dist((x, y), self._pressed_at) < CLICK_PX:
            return
        self._is_drag = True
        right, down = x - self._pointer[0], y - self._pointer[1]
        self._pointer = (x, y)
        self.state.orbit = self.state.orbit.orbited(right, down, self.state.limits)
