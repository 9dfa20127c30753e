"""A hand that clicks and types on panels, without a window or a GPU.

    hand = Hand(monkeypatch)
    orders = hand.click("Leave", lambda metrics: control_bar(view, metrics))

Where a button is is noted when it is drawn, by its label or by what its tooltip says.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from imgui_bundle import imgui

from pica_client.ui.events import (
    InputEvent,
    KeyPressed,
    KeyReleased,
    MouseMoved,
    MousePressed,
    MouseReleased,
    TextTyped,
)
from pica_client.ui.surface.surface import Surface
from pica_client.ui.surface.theme import Metrics

Show = Callable[[Metrics], list[Any]]
Rect = tuple[float, float, float, float]
NOTED = (
    "button",
    "invisible_button",
    "input_text",
    "input_text_with_hint",
    "checkbox",
    "selectable",
    "begin_combo",
    "image_button",
    "collapsing_header",
    "small_button",
    "menu_item_simple",
    "tree_node",
    "tree_node_ex",
    "slider_int",
    "begin_tab_item",
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


class Hand:
    """Steers panels on a surface of its own."""

    def __init__(
        self, patch: pytest.MonkeyPatch, size: tuple[int, int] = (1280, 720), scale: float = 1.0
    ) -> None:
        self.places = note_places(patch)
        self.surface = Surface(size, content_scale=scale)
        self._now = 0.0

    def frame(self, show: Show, *events: InputEvent) -> list[Any]:
        """One frame after some events; gives what the panel orders."""
        self._now += 0.05
        self.places.clear()
        for event in events:
            self.surface.receive(event)
        with self.surface.frame(self._now):
            return show(self.surface.metrics)

    def where(self, label: str) -> Rect:
        """Where the last frame drew a widget whose label holds a text."""
        found = [rect for known, rect in self.places.items() if label in known]
        assert found, f"{label!r} is not among {sorted(self.places)}"
        return found[0]

    def click(self, label: str, show: Show) -> list[Any]:
        """Click in the middle of a widget; gives all that is ordered meanwhile."""
        for _ in range(3):  # a card knows its size after one frame, and its place after two
            self.frame(show)
        left, top, right, bottom = self.where(label)
        place = ((left + right) / 2, (top + bottom) / 2)
        steps = (MouseMoved(*place), MousePressed(*place), MouseReleased(*place))
        orders = [order for step in steps for order in self.frame(show, step)]
        return orders + self.frame(show)

    def type(self, text: str, show: Show) -> list[Any]:
        """Type a text into what is in use."""
        return self.frame(show, TextTyped(text)) + self.frame(show)

    def press(self, key: str, show: Show, *, has_control: bool = False) -> list[Any]:
        """Press a key and let it go."""
        orders = self.frame(show, KeyPressed(key, has_control=has_control))
        return orders + self.frame(show, KeyReleased(key)) + self.frame(show)


@contextmanager
def open_hand(size: tuple[int, int] = (1280, 720), scale: float = 1.0) -> Iterator[Hand]:
    """A hand for a block."""
    with pytest.MonkeyPatch.context() as patch:
        hand = Hand(patch, size, scale)
        try:
            yield hand
        finally:
            hand.surface.close()
