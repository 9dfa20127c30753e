"""What the user does, and what it means: input events in, changes and orders out. Pure; no window.

One table, `BINDINGS`, says which key does what: it is what keys are looked up in, and what the help
shows. A mouse drags the view, its wheel comes closer, and a click pins a head.

    controls = Controls(ControlState())
    controls.receive(KeyPressed("L"), peers=("peer-1",))
    controls.state.layout, controls.take_orders()
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from typing import Literal

from pica_client.render.seats import LAYOUTS, Layout, ViewState

CLICK_PX = 5.0
"""A press that moves less than this before it is let go is a click."""
KEY_ORBIT_PX = 40.0
"""An arrow key drags the view by so many pixels."""
MAX_PINNED_BY_KEY = 9

LAYOUT_TITLES: dict[Layout, str] = {
    "line": "Line",
    "arc": "Arc",
    "table": "Round table",
    "grid": "Grid",
}


@dataclass(frozen=True, slots=True)
class KeyPressed:
    """A key went down, or repeats while it is held."""

    key: str
    """Its name as in `BINDINGS`: a letter, a digit, or such as "Escape" and "Left"."""
    is_repeat: bool = False
    has_control: bool = False
    """Whether Control (Command on a Mac) is held."""
    has_shift: bool = False


@dataclass(frozen=True, slots=True)
class TextTyped:
    """Characters, as the keyboard's layout makes them of keys."""

    text: str


@dataclass(frozen=True, slots=True)
class Scrolled:
    """The wheel was turned; positive is away from the user."""

    steps: float


@dataclass(frozen=True, slots=True)
class MousePressed:
    """The first button went down at a place of the picture, pixels, y down."""

    x_px: float
    y_px: float


@dataclass(frozen=True, slots=True)
class MouseMoved:
    """The pointer is somewhere else."""

    x_px: float
    y_px: float


@dataclass(frozen=True, slots=True)
class MouseReleased:
    """The first button was let go."""

    x_px: float
    y_px: float


@dataclass(frozen=True, slots=True)
class CloseWanted:
    """The window's own close button."""


InputEvent = (
    KeyPressed | TextTyped | Scrolled | MousePressed | MouseMoved | MouseReleased | CloseWanted
)


class Order(Enum):
    """What is to be done once, by whoever owns files and windows."""

    SCREENSHOT = auto()
    TOGGLE_RECORDING = auto()
    TOGGLE_FULL_SCREEN = auto()


OwnFace = Literal["none", "sent", "frozen", "muted"]
"""What becomes of the user's own face. none: there is none to send; frozen: the last expression
goes on being sent; muted: nothing is."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ControlState:
    """What the user wants to see."""

    layout: Layout = "arc"
    view: ViewState = field(default_factory=ViewState)
    pinned: str | None = None
    """The peer who fills the picture."""
    show_statistics: bool = False
    show_help: bool = False
    own_face: OwnFace = "none"
    wants_close: bool = False


Change = Callable[[ControlState], ControlState]


@dataclass(frozen=True, kw_only=True, slots=True)
class Binding:
    """One thing that keys do."""

    keys: tuple[str, ...]
    title: str
    """What the help says of it; empty is not shown there."""
    change: Change | None = None
    order: Order | None = None
    needs_own_face: bool = False
    repeats: bool = False
    """Whether holding the key does it again."""


def _next_layout(state: ControlState) -> ControlState:
    following = LAYOUTS[(LAYOUTS.index(state.layout) + 1) % len(LAYOUTS)]
    return replace(state, layout=following, view=ViewState())


def _own_face(wanted: OwnFace) -> Change:
    """Between this and simply being sent."""

    def change(state: ControlState) -> ControlState:
        return replace(state, own_face="sent" if state.own_face == wanted else wanted)

    return change


def _orbit(right_px: float, down_px: float) -> Change:
    return lambda state: replace(state, view=state.view.orbited(right_px, down_px))


def _zoom(steps: float) -> Change:
    return lambda state: replace(state, view=state.view.zoomed(steps))


BINDINGS: tuple[Binding, ...] = (
    Binding(keys=("L",), title="next layout", change=_next_layout),
    Binding(
        keys=("R",),
        title="reset view and pin",
        change=lambda state: replace(state, view=ViewState(), pinned=None),
    ),
    Binding(keys=("0",), title="pin nobody", change=lambda state: replace(state, pinned=None)),
    Binding(keys=("+", "="), title="come closer", change=_zoom(1.0), repeats=True),
    Binding(keys=("-",), title="go back", change=_zoom(-1.0), repeats=True),
    Binding(keys=("Left",), title="", change=_orbit(KEY_ORBIT_PX, 0.0), repeats=True),
    Binding(keys=("Right",), title="", change=_orbit(-KEY_ORBIT_PX, 0.0), repeats=True),
    Binding(keys=("Up",), title="", change=_orbit(0.0, KEY_ORBIT_PX), repeats=True),
    Binding(keys=("Down",), title="", change=_orbit(0.0, -KEY_ORBIT_PX), repeats=True),
    Binding(keys=("M",), title="mute own face", change=_own_face("muted"), needs_own_face=True),
    Binding(keys=("F",), title="freeze own face", change=_own_face("frozen"), needs_own_face=True),
    Binding(
        keys=("S",),
        title="statistics",
        change=lambda state: replace(state, show_statistics=not state.show_statistics),
    ),
    Binding(keys=("P",), title="picture into a file", order=Order.SCREENSHOT),
    Binding(keys=("V",), title="start or stop recording", order=Order.TOGGLE_RECORDING),
    Binding(keys=("F11",), title="full screen", order=Order.TOGGLE_FULL_SCREEN),
    Binding(
        keys=("H", "F1"),
        title="this help",
        change=lambda state: replace(state, show_help=not state.show_help),
    ),
    Binding(
        keys=("Q", "Escape"),
        title="leave",
        change=lambda state: replace(state, wants_close=True),
    ),
)
_BY_KEY = {key: binding for binding in BINDINGS for key in binding.keys}


def help_lines(own_face: OwnFace = "none") -> tuple[tuple[str, str], ...]:
    """The keys and what they do, for people: from the table that they are looked up in."""
    keys = [
        (", ".join(binding.keys), binding.title)
        for binding in BINDINGS
        if binding.title and not (binding.needs_own_face and own_face == "none")
    ]
    pointer = [
        ("drag, arrows", "look around"),
        ("wheel", "come closer, go back"),
        (f"click, 1 to {MAX_PINNED_BY_KEY}", "pin a participant, or not"),
    ]
    return (("Keys", ""), *pointer, *keys)


Picker = Callable[[float, float], str | None]
"""Who is at a place of the picture, pixels, y down."""


class Controls:
    """Turns input into what the user wants.

    Attributes:
        state: What is wanted now.
    """

    def __init__(self, state: ControlState | None = None) -> None:
        self.state = state or ControlState()
        self._orders: list[Order] = []
        self._pressed_at: tuple[float, float] | None = None
        self._pointer = (0.0, 0.0)
        self._is_drag = False

    def receive(
        self,
        event: InputEvent,
        *,
        peers: Sequence[str] = (),
        pick: Picker = lambda x_px, y_px: None,
    ) -> None:
        """Take one event.

        Args:
            event: What the user did.
            peers: Who is there, in the order of their seats: number keys pin them.
            pick: Who is at a place of the picture.
        """
        match event:
            case KeyPressed():
                self._press_key(event, peers)
            case Scrolled(steps=steps) if math.isfinite(steps):
                self.state = _zoom(steps)(self.state)
            case MousePressed(x_px=x, y_px=y):
                self._pressed_at = self._pointer = (x, y)
                self._is_drag = False
            case MouseMoved(x_px=x, y_px=y):
                self._move(x, y)
            case MouseReleased(x_px=x, y_px=y):
                if self._pressed_at is not None and not self._is_drag:
                    self._toggle_pin(pick(x, y))
                self._pressed_at = None
            case CloseWanted():
                self.state = replace(self.state, wants_close=True)
            case _:
                pass

    def take_orders(self) -> list[Order]:
        """What is to be done since the last call."""
        orders, self._orders = self._orders, []
        return orders

    def forget_absent(self, peers: Sequence[str]) -> None:
        """Let go of a pin on somebody who has left."""
        if self.state.pinned is not None and self.state.pinned not in peers:
            self.state = replace(self.state, pinned=None)

    def _press_key(self, event: KeyPressed, peers: Sequence[str]) -> None:
        if event.has_control:
            return  # the desktop's own
        if event.key.isdecimal() and event.key != "0":
            number = int(event.key)
            if not event.is_repeat and number <= len(peers):
                self._toggle_pin(peers[number - 1])
            return
        binding = _BY_KEY.get(event.key)
        if binding is None or (event.is_repeat and not binding.repeats):
            return
        if binding.needs_own_face and self.state.own_face == "none":
            return
        if binding.change is not None:
            self.state = binding.change(self.state)
        if binding.order is not None:
            self._orders.append(binding.order)

    def _move(self, x: float, y: float) -> None:
        if self._pressed_at is None:
            return
        if not self._is_drag and math.dist((x, y), self._pressed_at) < CLICK_PX:
            return
        self._is_drag = True
        right, down = x - self._pointer[0], y - self._pointer[1]
        self._pointer = (x, y)
        self.state = _orbit(right, down)(self.state)

    def _toggle_pin(self, peer: str | None) -> None:
        if peer is not None:
            pinned = None if self.state.pinned == peer else peer
            self.state = replace(self.state, pinned=pinned, view=ViewState())
