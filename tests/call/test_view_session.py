"""`pica view` around one stay in a room: the form in a window, what the relay says, preferences.

The window is one without a screen: a GL context and the events that the test has the user do.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from imgui_bundle import imgui

from helpers.hand import Event, press
from pica_client.avatars.library import AvatarLibrary
from pica_client.errors import OptionError
from pica_client.local_call.processes import Children
from pica_client.ui.lobby import JoinForm
from pica_client.ui.options import JoinOptions, ViewOptions
from pica_client.ui.session import first_state, view_calls
from pica_client.ui.state import PreferencesFile, ViewState
from pica_client.ui.window import Surface
from pica_core.gl import create_context

pytestmark = pytest.mark.call

NOBODY = "ws://127.0.0.1:9"
SIZE = (640, 360)


class ScreenlessWindow:
    """Stands in for `window.Window`: the user does one thing a frame."""

    happened: list[Event]

    def __init__(self, size: tuple[int, int]) -> None:
        self.context = create_context()
        self.surface = Surface(self.context)
        self.size_px = self.windowed_size = size
        self._screen = self.context.simple_framebuffer(size)

    def close(self) -> None:
        self.surface.close()
        self.context.release()

    def poll(self) -> bool:
        if self.happened:
            self.happened.pop(0)(self.surface.io)
        return True

    def begin(self, now: float, **options: Any) -> None:
        self.surface.begin(now, self.size_px)

    def show(self, draw: Callable[[Any], None]) -> None:
        draw(self._screen)


@pytest.fixture
def window_of(monkeypatch: pytest.MonkeyPatch) -> Callable[[list[Event]], None]:
    def prepare(happened: list[Event]) -> None:
        monkeypatch.setattr(ScreenlessWindow, "happened", list(happened), raising=False)
        monkeypatch.setattr("pica_client.ui.lobby.Window", ScreenlessWindow)

    return prepare


@pytest.fixture
def library() -> Iterator[AvatarLibrary]:
    found = AvatarLibrary(shipped=[])
    yield found
    found.close()


@pytest.fixture(scope="module")
def relay_url() -> Iterator[str]:
    with Children() as children:
        _, url = children.start_relay()
        yield url


OPTIONS = ViewOptions(size="640x360", seconds=0.4, layout="grid")
HEADLESS = replace(OPTIONS, headless=True)


def state_at(url: str, name: str = "guest") -> ViewState:
    return ViewState(url=url, room="lobby", name=name, source="", voice="none", layout="grid")


def test_a_relay_that_is_not_there_is_said_in_the_form(
    window_of: Callable[[list[Event]], None],
    library: AvatarLibrary,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    window_of([press(imgui.Key.enter)])
    state = state_at(NOBODY, "Ada")
    refusals: list[str] = []

    def refuse(form: JoinForm, error: BaseException) -> None:
        refusals.append(str(error))
        form.outcome = "asking"
        ScreenlessWindow.happened.append(press(imgui.Key.escape))

    monkeypatch.setattr(JoinForm, "refuse", refuse)
    result = view_calls(OPTIONS, state, library, PreferencesFile(tmp_path))
    assert result["frames_rendered"] == 0  # one can leave at the form
    assert len(refusals) == 1
    assert f"no relay answers at {NOBODY}" in refusals[0]


def test_who_joins_by_the_form_is_in_the_call_and_found_again_next_time(
    window_of: Callable[[list[Event]], None], library: AvatarLibrary, relay_url: str, tmp_path: Path
) -> None:
    window_of([press(imgui.Key.enter)])
    kept = PreferencesFile(tmp_path)
    state = state_at(relay_url, "Ada")
    state.token = "a-secret"
    result = view_calls(OPTIONS, state, library, kept)
    assert result["frames_rendered"] > 0
    found = kept.load()
    assert (found.url, found.room, found.name, found.layout) == (relay_url, "lobby", "Ada", "grid")
    assert "a-secret" not in kept.path.read_text()


def test_a_stay_begins_without_what_held_for_the_people_of_another(
    library: AvatarLibrary, relay_url: str
) -> None:
    state = state_at(relay_url)
    state.volumes, state.barred = {1: 0.0}, {"eve": "Eve"}
    state.side, state.is_talking = "settings", True
    assert view_calls(HEADLESS, state, library)["frames_rendered"] > 0
    assert (state.volumes, state.barred, state.side, state.is_talking) == ({}, {}, "none", False)


def test_who_comes_in_again_records_into_a_file_of_its_own_and_is_told_where(
    library: AvatarLibrary, relay_url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("av")
    film, picture = tmp_path / "call.mp4", tmp_path / "last.png"
    recording = replace(HEADLESS, record=film, png=picture)
    view_calls(recording, state_at(relay_url), library)
    first = film.read_bytes()
    view_calls(recording, state_at(relay_url), library)
    assert film.read_bytes() == first
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("wrote")]
    again = tmp_path / "call-0001.mp4"
    assert said == [f"wrote {each}" for each in (picture, film, picture, again)]
    assert again.stat().st_size > 0


def test_what_the_command_line_says_comes_before_what_was_kept(tmp_path: Path) -> None:
    kept = PreferencesFile(tmp_path)
    sent = ViewState(url="ws://old", room="old", name="Old", voice="none", source="webcam")
    kept.save(sent)
    state = first_state(ViewOptions(join=JoinOptions(room="new"), voice="speech"), kept)
    assert (state.url, state.room, state.name) == ("ws://old", "new", "Old")
    assert (state.source, state.voice) == ("webcam", "speech")
    for said, source in (("vmc", "vmc"), ("none", "")):
        assert first_state(ViewOptions(send=said), kept).source == source


def test_an_invite_link_leads_where_it_says() -> None:
    state = first_state(ViewOptions(link="https://host/there#token=abc"), None)
    assert (state.url, state.room, state.token) == ("wss://host", "there", "abc")
    with pytest.raises(OptionError, match="link: "):
        first_state(ViewOptions(link="https://host"), None)
