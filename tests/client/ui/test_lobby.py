"""The form and the waiting card, filled in, clicked and typed on without a window."""

import shlex
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import pytest
from imgui_bundle import imgui

from helpers.hand import Hand, open_hand
from pica_client.errors import RelayRefusedError, RelayUnreachableError, SourceError
from pica_client.sources import open_source
from pica_client.sources.registry import TRACKER_KINDS
from pica_client.ui.lobby import JoinForm, connecting_panel, join_panel, own_command
from pica_client.ui.options import ViewOptions
from pica_client.ui.session import link_of
from pica_client.ui.side import SOURCES
from pica_client.ui.state import ViewState
from pica_client.voice.sound.settings import SoundState
from pica_command.table import COMMANDS

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
    shown = Shown(replace(FILLED, name="", voice="mic"), SoundState(microphones=("Desk",)))
    state = shown.form.state
    hand.click("##name", shown)
    hand.type("Grace", shown)
    for label in ("avatar nora", "##source", "Watch only", "##microphone", "Desk"):
        hand.click(label, shown)
    assert (state.name, state.avatar, state.source) == ("Grace", "nora", "")
    assert (state.voice, state.sound.microphone) == ("mic", "Desk")
    for label in ("avatar nora", "##microphone", "Off: only listen", "Join"):
        hand.click(label, shown)
    assert (state.avatar, state.voice) == ("", "none")  # the avatar that goes by the name again
    assert shown.form.outcome == "join"


def test_the_form_says_how_to_make_an_avatar_of_ones_own(hand: Hand) -> None:
    shown = Shown(replace(FILLED, name="Ada Lovelace"))
    hand.click("Make my own", shown)
    hand.click("##own", shown)
    hand.type("x", shown)  # can be copied, not changed
    command = ["pica", "avatar", "make", "--photos", "FOLDER", "--name", "Ada Lovelace"]
    assert shlex.split(own_command(shown.form.state.name)) == command
    assert "avatar make" in COMMANDS


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


def test_waiting_can_be_given_up(hand: Hand) -> None:
    said: list[bool] = []
    hand.click("Cancel", lambda: said.append(connecting_panel()))
    assert True in said


def test_every_source_of_the_form_opens() -> None:
    # A tracker needs a port or a camera that a test machine may lack.
    trackers = {source for source, _ in SOURCES if source in TRACKER_KINDS}
    assert trackers == {"livelink", "vmc", "webcam"}
    assert all(open_source(source) for source, _ in SOURCES if source not in {"", *trackers})


def test_an_invite_link_in_the_first_field_fills_the_form() -> None:
    form = form_of()
    form.state.url = "https://relay.example/standup#token=abc"
    form.typed()
    assert form.state == replace(FILLED, url="wss://relay.example", room="standup", token="abc")
    form.state.url = "https://relay.example"
    form.typed()
    assert form.trouble is not None
    assert "names no room" in form.trouble[0]


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (RelayRefusedError("said no (code 4011)", code=4011), "valid token"),
        (RelayRefusedError("answers HTTP 404, not as a relay"), "No PiCA relay answers"),
        (RelayUnreachableError("no relay answers at ws://x (tried for 3 s)"), "No PiCA relay"),
        (SourceError("take.csv: no such file"), "take.csv: no such file"),
    ],
)
def test_why_joining_failed_is_said_until_something_is_typed(error: Exception, said: str) -> None:
    form = form_of()
    form.refuse(error)
    assert form.trouble is not None
    assert said in form.trouble[0]
    assert str(error) in form.trouble[0] + form.trouble[1]
    form.typed()
    assert form.trouble is None
    form.state.room = "a b"
    form.join()
    assert (form.outcome, form.trouble is None) == ("asking", False)
    form.state.room = "standup"
    form.join()
    assert form.outcome == "join"
