"""What a user does to a window, as plain values: keys, characters, the mouse. Pure."""

from dataclasses import dataclass

NAMED_KEYS = ("Escape", "Enter", "Tab", "Space", "Backspace", "Delete", "Home", "End")
ARROW_KEYS = ("Left", "Right", "Up", "Down")
"""Keys that have names; letters, digits and F1 to F12 are called as they are."""


@dataclass(frozen=True, slots=True)
class KeyPressed:
    """A key went down, or repeats while it is held."""

    key: str
    """Its name as in `controls.BINDINGS`: a letter, a digit, or such as "Escape" and "Left"."""
    is_repeat: bool = False
    has_control: bool = False
    """Whether Control (Command on a Mac) is held."""
    has_shift: bool = False


@dataclass(frozen=True, slots=True)
class KeyReleased:
    """A key was let go."""

    key: str
    has_control: bool = False
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
    """A button went down at a place of the picture, pixels, y down."""

    x_px: float
    y_px: float
    button: int = 0
    """0 is the left one, 1 the right one, 2 the middle one."""


@dataclass(frozen=True, slots=True)
class MouseMoved:
    """The pointer is somewhere else."""

    x_px: float
    y_px: float


@dataclass(frozen=True, slots=True)
class MouseReleased:
    """A button was let go."""

    x_px: float
    y_px: float
    button: int = 0


@dataclass(frozen=True, slots=True)
class CloseWanted:
    """The window's own close button."""


InputEvent = (
    KeyPressed
    | KeyReleased
    | TextTyped
    | Scrolled
    | MousePressed
    | MouseMoved
    | MouseReleased
    | CloseWanted
)
