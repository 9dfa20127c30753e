"""What the client's commands say about bad input, and with which status they end."""

from pathlib import Path
from typing import Any

import pytest

from helpers.toy import make_toy_avatar
from pica_client.cli import demo
from pica_command.main import main
from pica_core.avatar import file as avatar_file
from pica_core.avatar.file import save_avatar

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["send", "--fps", "1000"], "fps is 1000; 1 to 240 is allowed"),
        (["send", "--source", "voice"], "source voice needs --voice mic or a WAV file"),
        (["view", "--url", "ws://x", "--send", "voice"], "source voice needs --voice mic"),
        (["send", "--avatar", "nobody"], "avatar 'nobody' is unknown"),
        (
            ["view", "--headless", "--own-avatar", "nora"],
            "own-avatar is the look of your own face; to send one, add --send performance:talk",
        ),
        (["view", "--size", "big"], "size is 'big'; write COLUMNSxROWS"),
        (["view", "--avatar", "none.pica"], "none.pica: cannot be read"),
        (["view", "--expect", "-1"], "expect is -1; 0 to 63 is allowed"),
        (["view", "--record", "nowhere/a.mp4"], "nowhere/a.mp4: cannot be written"),
        (["demo", "--out", __file__], "test_commands.py: cannot be written: File exists"),
        (["demo", "--peers", "0"], "peers is 0; 1 to 15 fit the room"),
        (["demo", "--seconds", "0"], "seconds is 0; 1 to 3600 is allowed"),
        (["bench", "call", "--seconds", "-1"], "seconds is -1; 0.1 to 600"),
        (["bench", "voice", "--seconds", "8"], "seconds is 8; "),
        (["bench", "voice", "--scenarios", "storm"], "scenario 'storm' is unknown; known are"),
    ],
)
def test_bad_input_is_one_line_with_the_fix_and_exit_status_two(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    words = 2 if arguments[0] == "bench" else 1
    assert lines[0].startswith(f"pica {' '.join(arguments[:words])}: ")
    assert message in lines[0]


def test_no_film_is_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    film = tmp_path / "call.mp4"
    film.write_text("of yesterday")
    assert main(["view", "--url", "ws://127.0.0.1:9", "--headless", "--record", str(film)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"pica view: {film}: is there already; move it away or name another file"
    assert film.read_text() == "of yesterday"


def test_a_truncated_avatar_is_named_with_the_fix(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.pica"
    save_avatar(cut, make_toy_avatar())
    cut.write_bytes(cut.read_bytes()[:20_000])
    for command in ("send", "view"):
        assert main([command, "--avatar", str(cut)]) == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert line.startswith(f"pica {command}: {cut}: cut")
        assert line.endswith("get the file again")


def test_a_build_without_avatars_says_so_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(avatar_file.resources, "files", lambda package: tmp_path)
    assert main(["send"]) == 2
    assert capsys.readouterr().err == (
        "pica send: no avatar ships with this package; name one with --avatar FILE\n"
    )


@pytest.mark.parametrize(("drawn", "status"), [(15, 0), (14, 1), (0, 1)])
def test_a_demo_that_did_not_draw_everybody_ends_with_one_and_says_what_helps(
    drawn: int,
    status: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    stats: dict[str, Any] = {"peers": 15, "rendered_peers": drawn, "render_fps": 10.0}
    stats |= {"gl_renderer": "none", "latency_ms": {"p50": 1, "p99": 2}, "errors": 0}
    monkeypatch.setattr(demo, "run_demo", lambda config: stats)
    assert main(["demo", "--headless", "--out", str(tmp_path)]) == status
    said = capsys.readouterr().err
    assert f"{drawn} of 15 peers drawn" in said
    assert ("more --seconds or fewer --peers" in said) == (status == 1)
