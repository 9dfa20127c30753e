"""What the user wants: input events and orders of the surface in, changes and orders out. Pure.

One table, `BINDINGS`, says which key gives which order: keys are looked up in it, and the help and
the tooltips are read from it. Buttons give the same orders. A mouse drags the view, its wheel comes
closer, and a click pins a head.

    controls = Controls(ControlState())
    controls.receive(KeyPressed("L"), places=(0, 1))
    controls.obey(Pin(1))
    controls.state.layout, controls.take_orders()
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from typing import Literal

from pica_client.render.seats import LAYOUTS, Layout
from pica_client.render.views import OrbitLimits, ViewState
from pica_client.ui import events
from pica_client.ui.settings import OwnChoice, Settings
from pica_client.voice.sound.settings import SoundSettings
from pica_protocol.messages import Moderation

CLICK_PX = 5.0
"""A press that moves less than this before it is let go is a click."""
KEY_ORBIT_PX = 40.0
"""An arrow key drags the view by so many pixels."""
MAX_PINNED_BY_KEY = 9
TALK_KEY = "Space"
"""Held to be heard, where the settings say so."""

LAYOUT_TITLES: dict[Layout, str] = {
    "line": "Line",
    "arc": "Arc",
    "table": "Round table",
    "grid": "Grid",
}


class Order(Enum):
    """What a key or a button asks for."""

    NEXT_LAYOUT = auto()
    RESET_VIEW = auto()
    UNPIN = auto()
    COME_CLOSER = auto()
    GO_BACK = auto()
    LOOK_LEFT = auto()
    LOOK_RIGHT = auto()
    LOOK_UP = auto()
    LOOK_DOWN = auto()
    MUTE_FACE = auto()
    FREEZE_FACE = auto()
    MUTE_VOICE = auto()
    CALIBRATE = auto()
    REJOIN = auto()
    """Come again as whom the settings say."""
    STATISTICS = auto()
    PARTICIPANTS = auto()
    SETTINGS = auto()
    HELP = auto()
    SCREENSHOT = auto()
    TOGGLE_RECORDING = auto()
    TOGGLE_FULL_SCREEN = auto()
    CLOSE = auto()
    """Close what is open, or ask whether to leave."""
    STAY = auto()
    LEAVE = auto()
    DISMISS_HINT = auto()
    TEST_SOUND = auto()


@dataclass(frozen=True, slots=True)
class Pin:
    """Pin a participant, or let go of the one who is pinned."""

    place: int
    """Who is meant; see `pica_client.call.faces.FaceState.place`."""


@dataclass(frozen=True, slots=True)
class ChooseLayout:
    """Seat people so."""

    layout: Layout


@dataclass(frozen=True, slots=True)
class Say:
    """Tell the user something for a few seconds."""

    text: str


NO_FACE = Say("You show no face: choose a face source in the settings (--send)")
NO_VOICE = Say("You send no voice: choose a microphone in the settings (--voice mic)")


@dataclass(frozen=True, slots=True)
class CopyText:
    """Put a text into the clipboard, and say so."""

    text: str
    notice: str


@dataclass(frozen=True, slots=True)
class SetVolume:
    """Make somebody louder or softer here; 1 is as sent, 0 mutes."""

    place: int
    """Who is meant; see `Pin`."""
    volume: float


UserOrder = (
    Order
    | SetVolume
    | SoundSettings
    | Pin
    | ChooseLayout
    | Say
    | CopyText
    | Settings
    | OwnChoice
    | Moderation
)

OwnFace = Literal["none", "sent", "frozen", "muted"]
"""What becomes of the user's own face. none: there is none to send; frozen: the last expression
goes on being sent; muted: nothing is."""
OwnVoice = Literal["none", "sent", "muted"]
"""What becomes of the user's own voice; none: there is none to send."""
Side = Literal["none", "help", "participants", "settings"]
"""What stands in the panel at the right."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ControlState:
    """What the user wants to see."""

    layout: Layout = "arc"
    view: ViewState = field(default_factory=ViewState)
    limits: OrbitLimits = field(default_factory=OrbitLimits)
    """How far the view may turn: where people sit, and from where their avatars may be seen."""
    layouts: tuple[Layout, ...] = LAYOUTS
    """Those that there is room for; instead of another one the grid is shown."""
    pinned: int | None = None
    """The place of who fills the picture, also while that one is away."""
    show_statistics: bool = False
    side: Side = "none"
    asks_to_leave: bool = False
    own_face: OwnFace = "none"
    own_voice: OwnVoice = "none"
    is_talking: bool = False
    """Whether the key to talk is held."""
    sound: SoundSettings = field(default_factory=SoundSettings)
    volumes: Mapping[int, float] = field(default_factory=dict)
    """How loud people are here, by place; who is missing is as loud as sent."""
    settings: Settings = field(default_factory=Settings)
    entered_as: OwnChoice = field(default_factory=OwnChoice)
    """The name, avatar and source that the user came in with."""
    choice: OwnChoice = field(default_factory=OwnChoice)
    """Those that the user wants; a name or avatar only after coming again."""
    avatars: tuple[str, ...] = ()
    """Those to choose from, by name; none where one cannot come again as somebody else."""
    shows_hint: bool = False
    """Whether what one needs to know in the first call is shown."""
    wants_close: bool = False

    @property
    def is_heard(self) -> bool:
        """Whether one's own voice is to be sent now."""
        return self.own_voice == "sent" and (self.is_talking or not self.sound.push_to_talk)


Change = Callable[[ControlState], ControlState]


def _next_layout(state: ControlState) -> Layout:
    """The one after what is shown that there is room for; if there is no other, the wanted one."""
    shown = state.layout if state.layout in state.layouts else "grid"
    after = LAYOUTS.index(shown) + 1
    others = (*LAYOUTS[after:], *LAYOUTS[: after - 1])
    return next((each for each in others if each in state.layouts), state.layout)


def _own_face(wanted: OwnFace) -> Change:
    """Between this and simply being sent."""
    return lambda state: replace(state, own_face="sent" if state.own_face == wanted else wanted)


def _side(wanted: Side) -> Change:
    """Open a panel at the right, or close it."""
    return lambda state: replace(state, side="none" if state.side == wanted else wanted)


def _orbit(right_px: float, down_px: float) -> Change:
    return lambda state: replace(state, view=state.view.orbited(right_px, down_px, state.limits))


def _zoom(steps: float) -> Change:
    return lambda state: replace(state, view=state.view.zoomed(steps))


def _close(state: ControlState) -> ControlState:
    if state.asks_to_leave:
        return replace(state, asks_to_leave=False)
    if state.side != "none":
        return replace(state, side="none")
    return replace(state, asks_to_leave=True)


CHANGES: dict[Order, Change] = {
    Order.RESET_VIEW: lambda state: replace(state, view=ViewState(), pinned=None),
    Order.UNPIN: lambda state: replace(state, pinned=None),
    Order.COME_CLOSER: _zoom(1.0),
    Order.GO_BACK: _zoom(-1.0),
    Order.LOOK_LEFT: _orbit(KEY_ORBIT_PX, 0.0),
    Order.LOOK_RIGHT: _orbit(-KEY_ORBIT_PX, 0.0),
    Order.LOOK_UP: _orbit(0.0, KEY_ORBIT_PX),
    Order.LOOK_DOWN: _orbit(0.0, -KEY_ORBIT_PX),
    Order.MUTE_FACE: _own_face("muted"),
    Order.FREEZE_FACE: _own_face("frozen"),
    Order.MUTE_VOICE: lambda state: replace(
        state, own_voice="sent" if state.own_voice == "muted" else "muted"
    ),
    Order.STATISTICS: lambda state: replace(state, show_statistics=not state.show_statistics),
    Order.PARTICIPANTS: _side("participants"),
    Order.SETTINGS: _side("settings"),
    Order.HELP: _side("help"),
    Order.CLOSE: _close,
    Order.STAY: lambda state: replace(state, asks_to_leave=False),
    Order.LEAVE: lambda state: replace(state, wants_close=True),
    Order.DISMISS_HINT: lambda state: replace(state, shows_hint=False),
}
"""What orders change of the state; all others are for whoever owns files and windows."""
OF_THE_FACE = (Order.MUTE_FACE, Order.FREEZE_FACE, Order.CALIBRATE)
"""What only those order who send a face."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Binding:
    """One thing that keys do."""

    keys: tuple[str, ...]
    title: str
    """What the help says of it; empty is not shown there."""
    order: Order
    repeats: bool = False
    """Whether holding the key does it again."""


BINDINGS: tuple[Binding, ...] = (
    Binding(keys=("L",), title="next layout", order=Order.NEXT_LAYOUT),
    Binding(keys=("R",), title="reset view and pin", order=Order.RESET_VIEW),
    Binding(keys=("0",), title="pin nobody", order=Order.UNPIN),
    Binding(keys=("+", "="), title="come closer", order=Order.COME_CLOSER, repeats=True),
    Binding(keys=("-",), title="go back", order=Order.GO_BACK, repeats=True),
    Binding(keys=("Left",), title="", order=Order.LOOK_LEFT, repeats=True),
    Binding(keys=("Right",), title="", order=Order.LOOK_RIGHT, repeats=True),
    Binding(keys=("Up",), title="", order=Order.LOOK_UP, repeats=True),
    Binding(keys=("Down",), title="", order=Order.LOOK_DOWN, repeats=True),
    Binding(keys=("T",), title="mute own voice", order=Order.MUTE_VOICE),
    Binding(keys=("M",), title="mute own face", order=Order.MUTE_FACE),
    Binding(keys=("F",), title="freeze own face", order=Order.FREEZE_FACE),
    Binding(keys=("K",), title="calibrate the tracker", order=Order.CALIBRATE),
    Binding(keys=("U",), title="participants", order=Order.PARTICIPANTS),
    Binding(keys=("S",), title="statistics", order=Order.STATISTICS),
    Binding(keys=("P",), title="picture into a file", order=Order.SCREENSHOT),
    Binding(keys=("V",), title="start or stop recording", order=Order.TOGGLE_RECORDING),
    Binding(keys=("F11",), title="full screen", order=Order.TOGGLE_FULL_SCREEN),
    Binding(keys=("O",), title="settings", order=Order.SETTINGS),
    Binding(keys=("H", "F1"), title="this help", order=Order.HELP),
    Binding(keys=("Escape", "Q"), title="close, or leave", order=Order.CLOSE),
)
_BY_KEY = {key: binding for binding in BINDINGS for key in binding.keys}
KEYS_OF = {binding.order: binding.keys[0] for binding in BINDINGS}
"""The key that a tooltip names, by order."""


def help_lines(own_face: OwnFace = "none") -> tuple[tuple[str, str], ...]:
    """The keys and what they do, for people: from the table that they are looked up in."""
    keys = (
        (", ".join(binding.keys), binding.title)
        for binding in BINDINGS
        if binding.title and not (binding.order in OF_THE_FACE and own_face == "none")
    )
    return (
        ("drag, arrows", "look around"),
        ("wheel", "come closer, go back"),
        (f"click, 1 to {MAX_PINNED_BY_KEY}", "pin a participant, or not"),
        (TALK_KEY, "hold to talk, if set so"),
        *keys,
    )


class Controls:
    """Turns input into what the user wants."""

    def __init__(self, state: ControlState | None = None) -> None:
        self.state = state or ControlState()
        self._orders: list[UserOrder] = []
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
        match event:
            case events.KeyPressed():
                self._press_key(event, places)
            case events.KeyReleased(key=key) if key == TALK_KEY:
                self.state = replace(self.state, is_talking=False)
            case events.Scrolled(steps=steps) if math.isfinite(steps):
                self.state = _zoom(steps)(self.state)
            case events.MousePressed(x_px=x, y_px=y, button=0):
                self._pressed_at = self._pointer = (x, y)
                self._is_drag = False
            case events.MouseMoved(x_px=x, y_px=y):
                self._move(x, y)
            case events.MouseReleased(x_px=x, y_px=y, button=0):
                if self._pressed_at is not None and not self._is_drag:
                    self._toggle_pin(pick(x, y))
                self._pressed_at = None
            case events.CloseWanted():
                self.obey(Order.LEAVE)
            case _:
                pass

    def obey(self, order: UserOrder) -> None:
        """Take an order, from a key or from the surface."""
        match order:
            case Pin(place=place):
                self._toggle_pin(place)
            case ChooseLayout(layout=layout):
                self._seat(layout)
            case Order.NEXT_LAYOUT:
                self._seat(_next_layout(self.state))
            case Settings():
                self.state = replace(self.state, settings=order)
            case SoundSettings():
                self.state = replace(self.state, sound=order)
            case SetVolume(place=place, volume=volume):
                volumes = {**self.state.volumes, place: volume}
                self.state = replace(self.state, volumes=volumes)
            case OwnChoice():
                self.state = replace(self.state, choice=order)
                self._orders.append(order)
            case Order() if order in OF_THE_FACE and self.state.own_face == "none":
                self._orders.append(NO_FACE)
            case Order.MUTE_VOICE if self.state.own_voice == "none":
                self._orders.append(NO_VOICE)
            case Order() if order in CHANGES:
                self.state = CHANGES[order](self.state)
            case _:
                self._orders.append(order)

    def take_orders(self) -> list[UserOrder]:
        """What is to be done since the last call, by whoever owns files and windows."""
        orders, self._orders = self._orders, []
        return orders

    def _seat(self, layout: Layout) -> None:
        """Choose a layout, and say how people sit now."""
        self.state = replace(self.state, layout=layout, pinned=None, view=ViewState())
        title = LAYOUT_TITLES[layout]
        if layout not in self.state.layouts:
            title = f"{LAYOUT_TITLES['grid']} – no room here for: {title}"
        elif len(self.state.layouts) == 1:
            title += " – no room here for another"
        self._orders.append(Say(f"People sit: {title}"))

    def _press_key(self, event: events.KeyPressed, places: Sequence[int]) -> None:
        if event.has_control:
            return  # the desktop's own
        if event.key == TALK_KEY:
            self.state = replace(self.state, is_talking=True)
            return
        if event.key.isdecimal() and event.key != "0":
            number = int(event.key)
            if not event.is_repeat and number <= len(places):
                self._toggle_pin(places[number - 1])
            return
        if self.state.asks_to_leave and event.key == "Enter":
            self.obey(Order.LEAVE)
            return
        binding = _BY_KEY.get(event.key)
        if binding is None or (event.is_repeat and not binding.repeats):
            return
        self.obey(binding.order)

    def _move(self, x: float, y: float) -> None:
        if self._pressed_at is None:
            return
        if not self._is_drag and math.dist((x, y), self._pressed_at) < CLICK_PX:
            return
        self._is_drag = True
        right, down = x - self._pointer[0], y - self._pointer[1]
        self._pointer = (x, y)
        self.state = _orbit(right, down)(self.state)

    def _toggle_pin(self, place: int | None) -> None:
        if place is not None:
            pinned = None if self.state.pinned == place else place
            self.state = replace(self.state, pinned=pinned, view=ViewState())
