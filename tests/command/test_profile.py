"""Options from variables and the profile, and ``pica config``, which writes it."""

from __future__ import annotations

import json
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from pica_command.catalogue import commands, options_type_of
from pica_command.main import main
from pica_command.profile import PROFILE_VARIABLE, SHARED, variables_of

pytestmark = pytest.mark.unit


@pytest.fixture
def profile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "folder" / "profile.toml"
    monkeypatch.setenv(PROFILE_VARIABLE, str(path))
    return path


@pytest.fixture
def sources(capsys: pytest.CaptureFixture[str]) -> Callable[..., dict[str, list[object]]]:
    def _sources(*words: str) -> dict[str, list[object]]:
        assert main([*words, "--print-config", "--json"]) == 0
        told = json.loads(capsys.readouterr().out.splitlines()[-1])
        return {name: [each["value"], each["source"]] for name, each in told.items()}

    return _sources


def test_flags_go_before_variables_these_before_the_profile_that_before_defaults(
    profile: Path,
    monkeypatch: pytest.MonkeyPatch,
    sources: Callable[..., dict[str, list[object]]],
) -> None:
    profile.parent.mkdir()
    profile.write_text(
        'url = "wss://a:1"\nroom = "attic"\nname = "Ada"\nca_file = "ca.pem"\n'
        "[send]\nfps = 20\nquality = 5\nplain = true\n"
    )
    monkeypatch.setenv("PICA_ROOM", "cellar")
    monkeypatch.setenv("PICA_NAME", "Bob")
    monkeypatch.setenv("PICA_SEND_NAME", "Cyd")
    monkeypatch.setenv("PICA_SEND_QUALITY", "6")
    found = sources("send", "--room", "hall", "--no-plain")
    assert found["room"] == ["hall", "--room"]
    assert found["name"] == ["Cyd", "PICA_SEND_NAME"]
    assert found["quality"] == [6, "PICA_SEND_QUALITY"]
    assert found["fps"] == [20, str(profile)]
    assert found["plain"] == [False, "--plain"]
    assert found["url"] == ["wss://a:1", str(profile)]
    assert found["ca_file"] == [str(profile.parent / "ca.pem"), str(profile)]
    assert found["seconds"] == [0.0, "default"]
    # What is meant for those who join does not rename an avatar that is exported.
    assert (
        variables_of("export", options_type_of(commands()["export"])).keys()
        & {f"PICA_{name.upper()}" for name in SHARED}
        == set()
    )


def test_what_is_printed_for_a_command_is_its_table_of_a_profile(
    profile: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["send", "--fps", "12", "--name", "Ada", "--print-config"]) == 0
    profile.parent.mkdir()
    profile.write_text(capsys.readouterr().out)
    assert main(["send", "--print-config"]) == 0
    assert f"fps = 12.0  # {profile}" in capsys.readouterr().out


def test_config_sets_shows_and_unsets_in_a_file_for_its_owner_alone(
    profile: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["config", "set", "url", "wss://relay.example"]) == 0
    assert main(["config", "set", "token-file", str(tmp_path / "ada.token")]) == 0
    assert main(["config", "set", "send.fps", "25"]) == 0
    assert main(["config", "set", "bench.call.peers", "3"]) == 0
    assert stat.S_IMODE(profile.stat().st_mode) == 0o600
    capsys.readouterr()
    assert main(["config", "show"]) == 0
    assert capsys.readouterr().out == (
        f'url = "wss://relay.example"\ntoken_file = "{tmp_path}/ada.token"\n\n'
        "[send]\nfps = 25.0\n\n[bench.call]\npeers = 3\n"
    )
    assert main(["config", "unset", "send.fps"]) == 0
    assert main(["config", "unset", "url"]) == 0
    assert "fps" not in profile.read_text()
    assert main(["config", "path"]) == 0
    assert capsys.readouterr().out == f"{profile}\n"
    assert [path.name for path in profile.parent.iterdir()] == [profile.name]


def test_a_profile_behind_a_link_is_written_where_the_link_leads(
    profile: Path, tmp_path: Path
) -> None:
    kept = tmp_path / "dotfiles" / "pica.toml"
    kept.parent.mkdir()
    profile.parent.mkdir(exist_ok=True)
    profile.symlink_to(kept)

    assert main(["config", "set", "url", "wss://relay.example"]) == 0
    assert main(["config", "set", "send.fps", "25"]) == 0

    assert profile.is_symlink()
    assert "fps = 25.0" in kept.read_text()
    assert [path.name for path in kept.parent.iterdir()] == [kept.name]


def test_a_profile_holds_beside_words_behind_two_dashes(
    profile: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    profile.parent.mkdir()
    profile.write_text('url = "wss://relay.example"\nname = "Ada"\n')
    assert main(["send", "--print-config", "--name=Bob", "--"]) == 0
    printed = capsys.readouterr().out
    assert 'url = "wss://relay.example"' in printed
    assert 'name = "Bob"' in printed


@pytest.mark.parametrize("value", ["true", "false"])
def test_a_switch_that_may_be_absent_is_set_in_a_profile(
    profile: Path, capsys: pytest.CaptureFixture[str], value: str
) -> None:
    assert main(["config", "set", "view.clean", value]) == 0
    assert main(["view", "--print-config"]) == 0
    assert f"clean = {value}  # {profile}" in capsys.readouterr().out


def test_a_key_below_a_text_is_not_set(profile: Path, capsys: pytest.CaptureFixture[str]) -> None:
    profile.parent.mkdir()
    profile.write_text('room = "lobby"\n')
    assert main(["config", "unset", "room.l"]) == 2
    assert "room.l is not set in" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["set", "colour", "red"], "unknown key colour; write url, room, name"),
        (["set", "send.fsp", "3"], "pica send has no option fsp; did you mean fps?"),
        (["set", "send.fps", "fast"], "send.fps=fast must be a number"),
        (["set", "relay.port", "1"], "pica relay reads no profile; name a file with --config"),
        (["unset", "url"], "url is not set in"),
    ],
)
def test_what_config_does_not_take_is_one_line(
    profile: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    assert main(["config", *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"pica config {words[0]}: {message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("uurl = 'ws://a'", "PROFILE: unknown key uurl; above the tables may stand url, room"),
        ("[send]\nfsp = 1", "PROFILE: unknown key fsp; did you mean fps?"),
        ("[send]\nfps = 1000", "PROFILE: fps is 1000; 1 to 240 is allowed"),
        ("url = 'http://x'", "PROFILE: url 'http://x' is no relay address"),
        ("send = 1", "PROFILE: unknown key send"),
        ("url = ", "PROFILE: no TOML"),
    ],
)
def test_what_a_profile_says_wrong_is_one_line_that_names_it(
    profile: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    profile.parent.mkdir()
    profile.write_text(text)
    assert main(["send"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"pica send: {message.replace('PROFILE', str(profile))}")


def test_what_a_variable_says_wrong_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PICA_URL", "http://x")
    assert main(["send"]) == 2
    assert capsys.readouterr().err.startswith("pica send: PICA_URL 'http://x' is no relay address")
    monkeypatch.setenv("PICA_URL", "")
    monkeypatch.setenv("PICA_SEND_FSP", "1")
    assert main(["send"]) == 2
    assert "variable PICA_SEND_FSP; did you mean PICA_SEND_FPS?" in capsys.readouterr().err


def test_a_full_disk_leaves_the_former_profile_whole(
    profile: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["config", "set", "room", "attic"]) == 0

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pica_command.profile.os.replace", full)
    assert main(["config", "set", "room", "cellar"]) == 2
    assert "cannot be written: No space left on device" in capsys.readouterr().err
    assert profile.read_text() == 'room = "attic"\n'
    assert [path.name for path in profile.parent.iterdir()] == [profile.name]


@pytest.mark.parametrize("name", commands())
def test_every_option_of_every_command_can_stand_in_a_variable(name: str) -> None:
    variables = variables_of(name, options_type_of(commands()[name]))
    assert all(variable.startswith("PICA_") for variable in variables)
