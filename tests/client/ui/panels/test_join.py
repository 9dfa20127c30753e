"""The form and the waiting card, clicked and typed on without a window."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import pytest
from imgui_bundle import imgui

from helpers.hand import Hand, open_hand
from pica_client.errors import RelayRefusedError
from pica_client.ui.join_form import JoinForm
from pica_client.ui.options import ViewOptions
from pica_client.ui.panels.join import JoinView, connecting_panel, join_panel
from pica_client.ui.session import link_of
from pica_client.ui.state import ViewState
from pica_client.ui.surface.style import Metrics
from pica_client.voice.sound.settings import SoundSettings, SoundState

pytestmark = pytest.mark.unit

Key = imgui.Key

FILLED = ViewState(url="ws://127.0.0.1:8765", room="lobby", name="Ada", source="performance:talk")
SIZES = [((320, 240), 1.0), ((1280, 720), 1.0), ((2560, 1440), 1.0), ((2560, 1440), 2.0)]


class Shown:
    """A form on a surface."""

    def __init__(self, state: ViewState, sound: SoundState | None = None) -> None:
        self.form, self.sound = JoinForm(replace(state), partial(link_of, ViewOptions())), sound

    def __call__(self, metrics: Metrics) -> list[bool]:
        """Draw it; give whether a test sound was wanted."""
        portraits = dict.fromkeys(["amara", "nora"], 1)
        view = JoinView(portraits=portraits, default_avatar="amara", sound=self.sound)
        join_panel(self.form, view, metrics)
        return [self.form.wants_test]


@pytest.fixture
def hand() -> Iterator[Hand]:
    with open_hand() as found:
        yield found


def test_the_form_is_filled_and_joined_by_mouse_and_keys(hand: Hand) -> None:
    shown = Shown(replace(FILLED, name=""))
    hand.click("##name", shown)
    hand.type("Grace", shown)
    hand.click("avatar nora", shown)
    assert shown.form.state == replace(FILLED, name="Grace", avatar="nora")
    hand.click("Join", shown)
    assert shown.form.outcome == "join"


def test_a_microphone_and_a_loudspeaker_are_chosen_and_tried() -> None:
    with open_hand((1280, 1400)) as hand:
        _choose_and_try(hand)


def _choose_and_try(hand: Hand) -> None:
    state = SoundState(microphones=("Desk",), speakers=("Horn",), microphone_level=20)
    shown = Shown(replace(FILLED, voice="mic"), state)
    hand.click("##microphone", shown)
    hand.click("Desk", shown)
    assert (shown.form.state.voice, shown.form.state.sound.microphone) == ("mic", "Desk")
    assert not shown.form.shows_meters
    hand.click("Try the sound", shown)
    assert shown.form.shows_meters
    hand.click("##speaker", shown)
    hand.click("Horn", shown)
    hand.click("Hold Space to talk", shown)
    assert shown.form.state.sound == SoundSettings(
        microphone="Desk", speaker="Horn", push_to_talk=True
    )
    assert any(hand.click("Play a test sound", shown))
    hand.click("##microphone", shown)
    hand.click("Off: only listen", shown)
    assert shown.form.state.voice == "none"
    hand.frame(shown)
    assert not [label for label in hand.places if "to talk" in label]
    assert shown.form.outcome == "asking"


def test_the_avatar_that_goes_by_the_name_is_had_by_a_second_click(hand: Hand) -> None:
    shown = Shown(replace(FILLED, avatar="nora"))
    hand.click("avatar nora", shown)
    assert shown.form.state.avatar == ""


def test_one_who_only_watches_says_so_in_the_list_of_faces(hand: Hand) -> None:
    shown = Shown(FILLED)
    hand.click("##source", shown)
    hand.click("Watch only", shown)
    assert shown.form.state.source == ""


@pytest.mark.parametrize(("key", "outcome"), [(Key.enter, "join"), (Key.escape, "leave")])
def test_the_form_is_answered_by_a_key(hand: Hand, key: Key, outcome: str) -> None:
    shown = Shown(FILLED)
    hand.frame(shown)
    hand.press(key, shown)
    assert shown.form.outcome == outcome


@pytest.mark.parametrize(("size", "scale"), SIZES)
def test_the_form_keeps_to_the_window_also_with_an_error(
    size: tuple[int, int], scale: float
) -> None:
    shown = Shown(FILLED)
    shown.form.refuse(RelayRefusedError("ws://x: no (code 4011)", code=4011))
    with open_hand(size, scale) as hand:
        for _ in range(4):
            hand.frame(shown)
        fields = [rect for label, rect in hand.places.items() if label.startswith("##")]
    assert fields
    for left, _, right, _ in fields:
        assert 0 <= left < right <= size[0]


def test_what_is_waited_for_is_seen_in_the_first_frame(hand: Hand) -> None:
    hand.frame(lambda metrics: [connecting_panel("Connecting …", metrics)])
    lists = imgui.get_draw_data().cmd_lists
    shapes = {each._owner_name: each.vtx_buffer.size() for each in lists}
    assert shapes["connecting"] > 0


@pytest.mark.parametrize("way", ["button", "key"])
def test_waiting_can_be_given_up(hand: Hand, way: str) -> None:
    given_up: list[bool] = []

    def show(metrics: Metrics) -> list[bool]:
        given_up.append(connecting_panel("Connecting …", metrics))
        return []

    if way == "button":
        hand.click("Cancel", show)
    else:
        hand.frame(show)
        hand.press(Key.escape, show)
    assert given_up.count(True) == 1
