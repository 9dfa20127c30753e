"""A hand that clicks and types on panels, without a window or a GPU.

    with open_hand() as hand:
        hand.click("Leave", lambda: control_bar(state, call))

Where a button is is noted when it is drawn, by its label or by what its tooltip says. What the user
does is a function of ImGui's input, as `press(Key.l)` makes one.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from imgui_bundle import imgui

from pica_client.ui.window import Surface

Event = Callable[[imgui.IO], None]
Show = Callable[[], object]
Rect = tuple[float, float, float, float]
NOTED = (
    *("button", "invisible_button", "image_button", "small_button", "radio_button", "checkbox"),
    *("input_text", "input_text_with_hint", "begin_combo", "selectable", "slider_int"),
    *("collapsing_header", "menu_item_simple", "tree_node", "tree_node_ex", "begin_tab_item"),
)


def note_places(patch: pytest.MonkeyPatch) -> dict[str, Rect]:
    """Note from now on where ImGui's widgets are: left, top, right and bottom by label, pixels."""
    places: dict[str, Rect] = {}

    def noting(draw: Callable[..., Any]) -> Callable[..., Any]:
        def drawn(label: str, *arguments: Any, **options: Any) -> Any:
            result = draw(label, *arguments, **options)
            low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
            places[label] = (low.x, low.y, high.x, high.y)
            return result

        return drawn

    for name in NOTED:
        patch.setattr(imgui, name, noting(getattr(imgui, name)))
    return places


def press(key: imgui.Key, *, is_down: bool = True) -> Event:
    """A key that goes down, or up."""
    return lambda io: io.add_key_event(key, is_down)


def point(x: float, y: float) -> Event:
    """The pointer is somewhere else."""
    return lambda io: io.add_mouse_pos_event(x, y)


def hold(*, is_down: bool = True) -> Event:
    """The left button of the mouse goes down, or up."""
    return lambda io: io.add_mouse_button_event(0, is_down)


def write(text: str) -> Event:
    """Characters are typed."""
    return lambda io: io.add_input_characters_utf8(text)


@contextmanager
def frame(
    surface: Surface, now: float, size: tuple[int, int], scale: float = 1.0
) -> Iterator[None]:
    """A whole frame of a surface; panels are called within."""
    surface.begin(now, size, content_scale=scale)
    try:
        yield
    finally:
        surface.end()


class Hand:
    """Steers panels on a surface of its own."""

    def __init__(
        self, patch: pytest.MonkeyPatch, size: tuple[int, int] = (1280, 720), scale: float = 1.0
    ) -> None:
        self.places = note_places(patch)
        self.surface = Surface()
        self._size, self._scale = size, scale
        self._now = 0.0

    def frame(self, show: Show, *events: Event) -> Any:
        """One frame after some events; gives what the panel does."""
        self._now += 0.05
        self.places.clear()
        for event in events:
            event(self.surface.io)
        with frame(self.surface, self._now, self._size, self._scale):
            return show()

    def where(self, label: str) -> Rect:
        """Where the last frame drew a widget whose label holds a text."""
        found = [rect for known, rect in self.places.items() if label in known]
        assert found, f"{label!r} is not among {sorted(self.places)}"
        return found[0]

    def click(self, label: str, show: Show) -> None:
        """Click in the middle of a widget."""
        for _ in range(3):  # a card knows its size after one frame, and its place after two
            self.frame(show)
        left, top, right, bottom = self.where(label)
        place = ((left + right) / 2, (top + bottom) / 2)
        for events in ((point(*place),), (hold(),), (hold(is_down=False),), ()):
            self.frame(show, *events)

    def type(self, text: str, show: Show) -> None:
        """Type a text into what is in use."""
        self.frame(show, write(text))
        self.frame(show)

    def press(self, key: imgui.Key, show: Show) -> None:
        """Press a key and let it go."""
        for events in ((press(key),), (press(key, is_down=False),), ()):
            self.frame(show, *events)


@contextmanager
def open_hand(size: tuple[int, int] = (1280, 720), scale: float = 1.0) -> Iterator[Hand]:
    """A hand for a block."""
    with pytest.MonkeyPatch.context() as patch:
        hand = Hand(patch, size, scale)
        try:
            yield hand
        finally:
            hand.surface.close()
