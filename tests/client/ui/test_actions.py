"""What keys and mouse mean, on a surface without a window."""

from collections.abc import Iterator

import pytest
from imgui_bundle import imgui

from helpers.hand import Event, frame, hold, point, press
from pica_client.render.seats import LAYOUTS
from pica_client.render.views import ViewState as Orbit
from pica_client.ui.actions import ACTIONS, Request, help_lines, keyboard, mouse, settle
from pica_client.ui.state import LAYOUT_TITLES, ViewState
from pica_client.ui.window import Surface
from pica_client.voice.sound.settings import SoundSettings

pytestmark = pytest.mark.unit

KEY = imgui.Key


class Controls:
    """A user with a keyboard and a mouse."""

    def __init__(self, surface: Surface) -> None:
        self.surface, self.state, self.now = surface, ViewState(), 0.0
        self.requests: list[Request] = []
        self.place: int | None = None

    def frame(self, *events: Event, after_s: float = 0.05) -> None:
        for event in events:
            event(self.surface.io)
        self.now += after_s
        with frame(self.surface, self.now, (640, 360)):
            mouse(self.state, lambda x, y: self.place)
            keyboard(self.state)
        self.requests += settle(self.state)

    def press(self, *keys: imgui.Key) -> None:
        for key in keys:
            self.frame(press(key))
            self.frame(press(key, is_down=False))

    def click(self, place: int | None, *, by: float = 0.0) -> None:
        self.place = place
        for event in (point(100, 100), hold(), point(100 + by, 100), hold(is_down=False)):
            self.frame(event)


@pytest.fixture
def controls() -> Iterator[Controls]:
    with Surface() as surface:
        yield Controls(surface)


def test_every_key_has_one_meaning() -> None:
    keys = [key for row in ACTIONS.values() for key in row.keys]
    assert len(keys) == len(set(keys))


def test_the_help_shows_every_titled_key_with_its_title(controls: Controls) -> None:
    shown = dict(help_lines(ViewState(own_face="sent", own_voice="sent")))
    for row in ACTIONS.values():
        if row.title:
            assert shown[", ".join(row.key_names)] == row.title
    assert shown["Escape, Q"] == "close, or leave"


def test_the_key_to_talk_is_held(controls: Controls) -> None:
    state = controls.state = ViewState(own_voice="sent", sound=SoundSettings(push_to_talk=True))
    heard = []
    for events in ((), (press(KEY.space),), (), (press(KEY.space, is_down=False),)):
        controls.frame(*events)
        heard.append(state.is_heard)
    assert heard == [False, True, True, False]
    controls.press(KEY.t)
    controls.frame(press(KEY.space))
    assert not state.is_heard  # a muted voice is not heard by a key


def test_panels_open_and_close_by_key(controls: Controls) -> None:
    seen = []
    for key in (KEY.o, KEY.h, KEY.u, KEY.u):
        controls.press(key)
        seen.append(controls.state.side)
    assert seen == ["settings", "help", "participants", "none"]


def test_layouts_follow_each_other_and_come_round(controls: Controls) -> None:
    controls.state = ViewState(layout=LAYOUTS[0], pinned=2)
    controls.press(*[KEY.l] * len(LAYOUTS))
    assert controls.state.layout == LAYOUTS[0]
    assert controls.state.pinned is None  # else nothing would be seen of them
    assert controls.requests[-1] == f"Layout: {LAYOUT_TITLES[LAYOUTS[0]]}"


@pytest.mark.parametrize("key", [KEY.q, KEY.escape])
def test_leaving_by_key_is_asked_once_and_enter_leaves(controls: Controls, key: imgui.Key) -> None:
    controls.press(key)
    assert (controls.state.asks_to_leave, controls.state.wants_close) == (True, False)
    controls.press(KEY.enter)
    assert controls.state.wants_close


def test_escape_closes_what_is_open_and_takes_the_question_back(controls: Controls) -> None:
    controls.press(KEY.h, KEY.escape)
    assert (controls.state.side, controls.state.asks_to_leave) == ("none", False)
    controls.press(KEY.escape, KEY.escape, KEY.enter)
    assert (controls.state.asks_to_leave, controls.state.wants_close) == (False, False)


def test_a_click_on_a_head_pins_it_and_a_drag_over_it_does_not(controls: Controls) -> None:
    controls.click(4)
    assert controls.state.pinned == 4
    controls.click(7, by=50)
    assert controls.state.pinned == 4
    controls.click(None)
    assert controls.state.pinned == 4
    controls.click(4, by=3)  # a hand trembles
    assert controls.state.pinned is None


def test_a_drag_turns_the_view_the_wheel_comes_closer_and_reset_undoes_all(
    controls: Controls,
) -> None:
    controls.frame(point(500, 300))
    assert controls.state.orbit == Orbit()
    controls.click(None, by=100)
    assert controls.state.orbit.yaw < 0
    controls.frame(lambda io: io.add_mouse_wheel_event(0.0, 3.0))
    assert controls.state.orbit.zoom > 1.3
    controls.state.pinned = 4
    controls.press(KEY.r)
    assert (controls.state.orbit, controls.state.pinned) == (Orbit(), None)


def test_the_desktops_own_shortcuts_are_left_alone(controls: Controls) -> None:
    controls.frame(press(KEY.mod_ctrl), press(KEY.left_ctrl))
    controls.press(KEY.q)
    assert not controls.state.asks_to_leave
