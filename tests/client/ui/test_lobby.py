"""The form and the waiting card, filled in, clicked and typed on without a window."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import pytest
from imgui_bundle import imgui

from helpers.hand import Hand, open_hand
from pica_client.errors import RelayRefusedError, RelayUnreachableError, SourceError
from pica_client.sources import open_source
from pica_client.sources.registry import TRACKER_KINDS
from pica_client.ui.lobby import REFUSALS, JoinForm, connecting_panel, join_panel
from pica_client.ui.options import ViewOptions
from pica_client.ui.panels.settings import SOURCES
from pica_client.ui.session import link_of
from pica_client.ui.state import ViewState
from pica_client.voice.sound.settings import SoundState
from pica_protocol.errors import CloseCode, is_worth_retrying

pytestmark = pytest.mark.unit

Key = imgui.Key

FILLED = ViewState(url="ws://127.0.0.1:8765", room="lobby", name="Ada", source="performance:talk")
SIZES = [((320, 240), 1.0), ((1280, 720), 1.0), ((2560, 1440), 1.0), ((2560, 1440), 2.0)]


def form_of(state: ViewState = FILLED) -> JoinForm:
    return JoinForm(state=replace(state), link_of=partial(link_of, ViewOptions()))


class Shown:
    """A form on a surface."""

    def __init__(self, state: ViewState, sound: SoundState | None = None) -> None:
        self.form = form_of(state)
        self.form.names, self.form.sound = ("amara", "nora"), sound
        self.form.portraits = dict.fromkeys(self.form.names, 1)

    def __call__(self) -> list[object]:
        join_panel(self.form)
        return []


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


def test_a_microphone_is_chosen_or_none(hand: Hand) -> None:
    shown = Shown(replace(FILLED, voice="mic"), SoundState(microphones=("Desk",)))
    hand.click("##microphone", shown)
    hand.click("Desk", shown)
    assert (shown.form.state.voice, shown.form.state.sound.microphone) == ("mic", "Desk")
    hand.click("##microphone", shown)
    hand.click("Off: only listen", shown)
    assert shown.form.state.voice == "none"


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
    hand.frame(lambda: [connecting_panel("Connecting …")])
    lists = imgui.get_draw_data().cmd_lists
    shapes = {each._owner_name: each.vtx_buffer.size() for each in lists}
    assert shapes["connecting"] > 0


@pytest.mark.parametrize("way", ["button", "key"])
def test_waiting_can_be_given_up(hand: Hand, way: str) -> None:
    given_up: list[bool] = []

    def show() -> list[bool]:
        given_up.append(connecting_panel("Connecting …"))
        return []

    if way == "button":
        hand.click("Cancel", show)
    else:
        hand.frame(show)
        hand.press(Key.escape, show)
    assert given_up.count(True) == 1


@pytest.mark.parametrize(
    ("state", "error"),
    [
        (replace(FILLED, url="http://x"), "is no relay address"),
        (replace(FILLED, url="ws://[x:99999"), "is no relay address"),
        (replace(FILLED, room="a b"), "room must be"),
        (replace(FILLED, name=" "), "name must"),
    ],
)
def test_what_cannot_be_right_is_said(state: ViewState, error: str) -> None:
    form = form_of(state)
    form.join()
    assert form.outcome == "asking"
    assert form.trouble is not None
    assert error in form.trouble[0]


def test_a_refused_join_can_be_tried_again_and_typing_takes_the_error_away() -> None:
    form = form_of()
    form.join()
    form.refuse(RelayUnreachableError("no relay answers"))
    assert (form.outcome, form.trouble is None) == ("asking", False)
    form.typed()
    assert form.trouble is None
    form.join()
    assert form.outcome == "join"


def test_every_source_of_the_form_opens() -> None:
    # A tracker needs a port or a camera that a test machine may lack.
    trackers = {source for source, _ in SOURCES if source in TRACKER_KINDS}
    assert trackers == {"livelink", "vmc", "webcam"}
    assert all(open_source(source) for source, _ in SOURCES if source not in {"", *trackers})


def test_an_invite_link_in_the_first_field_fills_the_form() -> None:
    form = form_of()
    form.state.url = "pica://relay.example/standup#token=abc"
    form.typed()
    assert form.state == replace(
        FILLED,
        url="wss://relay.example",
        room="standup",
        token="abc",
        name="Ada",
    )
    form.state.url = "pica://relay.example"
    form.typed()
    assert form.trouble is not None
    assert "names no room" in form.trouble[0]


# What a client cannot cause by joining, or what is tried again without a word.
NEVER_AT_THE_FORM = {
    CloseCode.NORMAL,
    CloseCode.PROTOCOL_ERROR,
    CloseCode.INVALID_TEXT,
    CloseCode.MESSAGE_TOO_BIG,
    CloseCode.MALFORMED,
    CloseCode.UNEXPECTED_MESSAGE,
    CloseCode.FOREIGN_STREAM,
    CloseCode.UNFIT_FILE,
    CloseCode.STORE_FULL,
}


def test_every_close_code_that_ends_a_join_has_words_and_a_remedy() -> None:
    final = {code for code in CloseCode if not is_worth_retrying(code)} - NEVER_AT_THE_FORM
    assert final <= REFUSALS.keys()


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (RelayRefusedError("said no (code 4011)", code=4011), "valid token"),
        (RelayRefusedError("answers HTTP 404, not as a relay"), "No PiCA relay answers"),
        (RelayUnreachableError("no relay answers at ws://x (tried for 3 s)"), "No PiCA relay"),
        (SourceError("take.csv: no such file"), "take.csv: no such file"),
    ],
)
def test_why_joining_failed_is_said_with_the_raw_error(error: Exception, said: str) -> None:
    form = form_of()
    form.refuse(error)
    assert form.trouble is not None
    assert said in form.trouble[0]
    assert str(error) in form.trouble[0] + form.trouble[1]
