"""The user's own preferences: kept whole, never in the way, never a secret among them; and from the
options of `pica view` to the connection that is asked for."""

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest

from pica_client.ui.options import JoinOptions, ViewOptions
from pica_client.ui.session import first_state, link_of
from pica_client.ui.state import PreferencesFile, ViewState
from pica_client.voice.sound.settings import SoundSettings

pytestmark = pytest.mark.unit

KEPT = ViewState(
    sound=SoundSettings(speaker="Horn", volume=0.5, push_to_talk=True),
    voice="mic",
    layout="table",
    window_size=(1280, 720),
    url="wss://relay.example:8765",
    room="standup",
    name="Ada",
    scale=1.25,
    shows_self=False,
)


@pytest.fixture
def kept(tmp_path: Path) -> PreferencesFile:
    return PreferencesFile(tmp_path / "made" / "when needed")


def test_what_is_saved_is_loaded_without_what_belongs_to_one_call(kept: PreferencesFile) -> None:
    kept.save(replace(KEPT, token="abc", pinned=2, side="help", volumes={1: 0.5}))
    assert kept.load() == KEPT
    assert "abc" not in kept.path.read_text()


@pytest.mark.parametrize(
    "content",
    [
        "",
        "null",
        '{"layout": "pyramid"}',
        '{"window_size": [0, 5, 7]}',
        '{"window_size": null}',
        '{"sound": {"volume": 9}}',
        "[" * 20_000,
    ],
)
def test_a_damaged_file_is_one_warning_and_defaults(
    kept: PreferencesFile, content: str, capsys: pytest.CaptureFixture[str]
) -> None:
    kept.path.parent.mkdir(parents=True)
    kept.path.write_text(content)
    assert kept.load() == ViewState()
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(str(kept.path))


def test_no_secret_of_an_address_is_kept(kept: PreferencesFile) -> None:
    kept.save(ViewState(url="wss://ada:word@relay.example:99/way?token=abc#part"))
    text = kept.path.read_text()
    assert json.loads(text)["url"] == "wss://relay.example:99/way"
    assert "word" not in text
    assert "abc" not in text


def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    kept: PreferencesFile, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kept.save(KEPT)

    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    kept.save(ViewState())
    assert "No space left" in capsys.readouterr().err
    assert kept.load() == KEPT
    assert [path.name for path in kept.path.parent.iterdir()] == [kept.path.name]


# Where it leads


FILLED = ViewState(url="ws://127.0.0.1:8765", room="lobby", name="Ada")


def test_a_token_is_not_printed_but_joined_with() -> None:
    state = replace(FILLED, token="abcdef")
    link = link_of(ViewOptions(), state)
    assert link.token == "abcdef"
    assert "abcdef" not in repr(state) + repr(link)


def test_a_typed_token_takes_the_place_of_a_token_file(tmp_path: Path) -> None:
    options = ViewOptions(join=JoinOptions(token_file=tmp_path / "token"))
    assert link_of(options, FILLED).token_file == tmp_path / "token"
    assert link_of(options, replace(FILLED, token="t")).token_file is None


@pytest.mark.parametrize(
    ("relay", "link", "is_sent"),
    [
        ("wss://relay.example", "https://evil.example/fun", False),
        ("wss://relay.example", "https://relay.example/fun", True),
        ("wss://relay.example", "http://relay.example/fun", False),
        ("wss://relay.example", "https://relay.example:8443/fun", False),
        ("", "https://evil.example/fun", False),
    ],
)
def test_an_invite_link_takes_a_token_file_to_no_other_relay(
    relay: str, link: str, is_sent: bool, tmp_path: Path
) -> None:
    options = ViewOptions(link, join=JoinOptions(url=relay, token_file=tmp_path / "token"))
    assert (link_of(options, first_state(options, None)).token_file is None) != is_sent
