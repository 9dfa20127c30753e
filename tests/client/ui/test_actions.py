"""What keys and mouse mean, without a window."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.render.seats import LAYOUTS
from pica_client.render.views import ViewState as Orbit
from pica_client.ui.actions import ACTIONS, NO_FACE, NO_VOICE, Action, Controls, help_lines
from pica_client.ui.events import (
    CloseWanted,
    InputEvent,
    KeyPressed,
    KeyReleased,
    MouseMoved,
    MousePressed,
    MouseReleased,
    Scrolled,
    TextTyped,
)
from pica_client.ui.state import LAYOUT_TITLES, ViewState
from pica_client.ui.window import KEY_NAMES
from pica_client.voice.sound.settings import SoundSettings

pytestmark = pytest.mark.unit

PLACES = (4, 7, 9)


def press(controls: Controls, *keys: str) -> None:
    for key in keys:
        controls.receive(KeyPressed(key), places=PLACES)


def click(controls: Controls, place: int | None, *, by_px: float = 0.0) -> None:
    controls.receive(MousePressed(100, 100))
    if by_px:
        controls.receive(MouseMoved(100 + by_px, 100))
    controls.receive(MouseReleased(100 + by_px, 100), pick=lambda x, y: place)


def test_every_key_has_one_meaning() -> None:
    keys = [key for binding in ACTIONS.values() for key in binding.keys]
    assert len(keys) == len(set(keys))
    assert not {str(number) for number in range(1, 10)} & set(keys)  # these pin


def test_the_window_knows_every_key_that_means_something() -> None:
    known = set(KEY_NAMES.values())
    for binding in ACTIONS.values():
        # A key may have two names; one of them is on every keyboard.
        assert not binding.keys or set(binding.keys) & known, binding.keys
    assert {"Enter", "Tab", "Backspace", "Escape", "Up", "Down", "U", "V"} <= known
    assert {str(number) for number in range(10)} <= known


def test_the_key_to_talk_is_held() -> None:
    controls = Controls(ViewState(own_voice="sent", sound=SoundSettings(push_to_talk=True)))
    heard = []
    for event in (KeyPressed("Space"), KeyPressed("Space", is_repeat=True), KeyReleased("Space")):
        heard.append(controls.state.is_heard)
        controls.receive(event)
    assert [*heard, controls.state.is_heard] == [False, True, True, False]
    controls.receive(KeyPressed("T"))
    controls.receive(KeyPressed("Space"))
    assert not controls.state.is_heard  # who has muted oneself is not heard by a key
    controls.state.sound = SoundSettings()
    controls.receive(KeyReleased("Space"))
    controls.receive(KeyPressed("T"))
    assert controls.state.is_heard


def test_every_button_of_the_bar_has_a_key_that_does_the_same() -> None:
    assert all(row.keys for row in ACTIONS.values() if row.button is not None)


def test_the_help_shows_every_titled_key_with_its_title() -> None:
    shown = dict(help_lines(ViewState(own_face="sent")))
    for binding in ACTIONS.values():
        if binding.title:
            assert shown[", ".join(binding.keys)] == binding.title


def test_a_key_of_the_help_does_what_the_help_says() -> None:
    controls = Controls()
    press(controls, "S")
    assert controls.state.show_statistics
    press(controls, "H")
    assert controls.state.side == "help"
    press(controls, "U")
    assert controls.state.side == "participants"
    press(controls, "S", "U")
    assert not controls.state.show_statistics
    assert controls.state.side == "none"


def test_layouts_follow_each_other_and_come_round() -> None:
    controls = Controls(ViewState(layout=LAYOUTS[0], pinned=2))
    seen = []
    for _ in LAYOUTS:
        seen.append(controls.state.layout)
        press(controls, "L")
    assert seen == list(LAYOUTS)
    assert controls.state.layout == LAYOUTS[0]
    assert controls.state.pinned is None  # else nothing would be seen of them
    said = [f"People sit: {LAYOUT_TITLES[each]}" for each in (*LAYOUTS[1:], LAYOUTS[0])]
    assert controls.take_requests() == said


def test_a_layout_that_looks_like_the_grid_is_skipped_and_not_announced() -> None:
    controls = Controls(ViewState(layout="table", layouts=("arc", "grid")))
    press(controls, "L", "L")
    assert controls.take_requests() == ["People sit: Arc", "People sit: Grid"]
    said = controls.state.seat("line")
    assert controls.state.layout == "line"  # as soon as there is room
    assert said == "People sit: Grid – no room here for: Line"


def test_where_only_the_grid_has_room_the_user_is_told() -> None:
    controls = Controls(ViewState(layout="arc", layouts=("grid",)))
    press(controls, "L")
    assert controls.state.layout == "arc"
    assert controls.take_requests() == ["People sit: Grid – no room here for: Arc"]
    assert controls.state.seat("grid") == "People sit: Grid – no room here for another"
    press(controls, "L")
    assert controls.take_requests() == ["People sit: Grid – no room here for another"]


@pytest.mark.parametrize("key", ["Q", "Escape"])
def test_leaving_by_key_is_asked_once_and_enter_leaves(key: str) -> None:
    controls = Controls()
    press(controls, key)
    assert controls.state.asks_to_leave
    assert not controls.state.wants_close
    press(controls, "Enter")
    assert controls.state.wants_close


def test_escape_closes_what_is_open_before_it_asks_and_takes_the_question_back() -> None:
    controls = Controls()
    press(controls, "H", "Escape")
    assert (controls.state.side, controls.state.asks_to_leave) == ("none", False)
    press(controls, "Escape", "Escape")
    assert not controls.state.asks_to_leave
    press(controls, "Enter")
    assert not controls.state.wants_close


def test_closing_the_window_is_leaving() -> None:
    controls = Controls()
    controls.receive(CloseWanted())
    assert controls.state.wants_close


def test_a_number_pins_and_the_same_number_lets_go() -> None:
    controls = Controls()
    press(controls, "2")
    assert controls.state.pinned == 7
    press(controls, "3")
    assert controls.state.pinned == 9
    press(controls, "3")
    assert controls.state.pinned is None
    press(controls, "9")
    assert controls.state.pinned is None


def test_a_click_on_a_head_pins_it_and_a_drag_over_it_does_not() -> None:
    controls = Controls()
    click(controls, 4)
    assert controls.state.pinned == 4
    click(controls, 7, by_px=50)
    assert controls.state.pinned == 4
    click(controls, None)
    assert controls.state.pinned == 4
    click(controls, 4)
    assert controls.state.pinned is None


def test_a_hand_that_trembles_clicks_all_the_same() -> None:
    controls = Controls()
    click(controls, 4, by_px=3)
    assert controls.state.pinned == 4
    assert controls.state.orbit == Orbit()


def test_dragging_turns_the_view_and_moving_alone_does_not() -> None:
    controls = Controls()
    controls.receive(MouseMoved(500, 500))
    assert controls.state.orbit == Orbit()
    click(controls, None, by_px=100)
    assert controls.state.orbit.yaw < 0


def test_the_wheel_comes_closer_and_reset_undoes_all() -> None:
    controls = Controls()
    controls.receive(Scrolled(3))
    assert controls.state.orbit.zoom > 1.3
    press(controls, "1", "R")
    assert controls.state.orbit == Orbit()
    assert controls.state.pinned is None


def test_requests_are_given_once() -> None:
    controls = Controls()
    press(controls, "P", "V", "F11")
    assert controls.take_requests() == [
        Action.SCREENSHOT,
        Action.RECORD,
        Action.FULL_SCREEN,
    ]
    assert controls.take_requests() == []


def test_a_held_key_repeats_only_where_that_makes_sense() -> None:
    controls = Controls()
    controls.receive(KeyPressed("S", is_repeat=True))
    assert not controls.state.show_statistics
    controls.receive(KeyPressed("Left", is_repeat=True))
    assert controls.state.orbit.yaw != 0


def test_ones_own_face_is_muted_and_frozen_by_those_who_send_one() -> None:
    watcher = Controls()
    press(watcher, "M")
    assert watcher.state.own_face == "none"
    controls = Controls(ViewState(own_face="sent"))
    steps = []
    for key in ("M", "F", "F", "M", "M"):
        press(controls, key)
        steps.append(controls.state.own_face)
    assert steps == ["muted", "frozen", "sent", "muted", "sent"]


def test_ones_own_voice_is_muted_by_those_who_send_one_and_explained_to_others() -> None:
    watcher = Controls()
    press(watcher, "T")
    assert watcher.state.own_voice == "none"
    assert watcher.take_requests() == [NO_VOICE]
    controls = Controls(ViewState(own_voice="sent"))
    steps = []
    for _ in range(3):
        press(controls, "T")
        steps.append(controls.state.own_voice)
    assert steps == ["muted", "sent", "muted"]


def test_the_desktops_own_shortcuts_are_left_alone() -> None:
    controls = Controls()
    controls.receive(KeyPressed("Q", has_control=True))
    assert not controls.state.wants_close


numbers = st.floats(allow_nan=True, allow_infinity=True)
coordinates = st.floats(-1e5, 1e5)
events: st.SearchStrategy[InputEvent] = st.one_of(
    st.builds(KeyPressed, st.text(max_size=3), is_repeat=st.booleans()),
    st.builds(KeyPressed, st.sampled_from([key for each in ACTIONS.values() for key in each.keys])),
    st.builds(TextTyped, st.text(max_size=5)),
    st.builds(Scrolled, numbers),
    st.builds(MousePressed, coordinates, coordinates),
    st.builds(MouseMoved, coordinates, coordinates),
    st.builds(MouseReleased, coordinates, coordinates),
)


@given(st.lists(events, max_size=40))
def test_whatever_is_typed_and_clicked_the_view_stays_a_view(happened: list[InputEvent]) -> None:
    controls = Controls()
    for event in happened:
        controls.receive(event, places=PLACES, pick=lambda x, y: 4)
    view = controls.state.orbit
    assert abs(view.pitch) <= 1.4
    assert 0.25 <= view.zoom <= 12
    assert controls.state.pinned in (None, *PLACES)


@pytest.mark.parametrize("key", ["M", "F"])
def test_who_shows_no_face_is_told_what_to_do_for_one(key: str) -> None:
    controls = Controls(ViewState())
    controls.receive(KeyPressed(key))
    assert controls.state.own_face == "none"
    assert controls.take_requests() == [NO_FACE]
