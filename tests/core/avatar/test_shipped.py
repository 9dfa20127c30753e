"""Names of shipped avatars stand for their files in every command that takes one."""

from pathlib import Path

import pytest

from pica_command.main import main
from pica_core.avatar.shipped import avatar_file, shipped_avatar_files
from pica_core.errors import AvatarFileError

pytestmark = pytest.mark.unit


def test_a_name_is_a_shipped_file_whatever_its_case_and_a_file_is_itself(tmp_path: Path) -> None:
    for path in shipped_avatar_files():
        assert avatar_file(Path(path.stem)) == avatar_file(Path(path.stem.title())) == path
    assert avatar_file(tmp_path / "me.pica") == tmp_path / "me.pica"
    with pytest.raises(AvatarFileError, match="avatar 'nobody' is unknown; shipped are: ines, "):
        avatar_file(Path("nobody"))


@pytest.mark.parametrize(
    "words",
    [
        ["avatar", "info"],
        ["avatar", "verify"],
        ["avatar", "precision"],
        ["avatar", "push"],
        ["avatar", "thumbnail"],
        ["avatar", "measure", "--out", "out.pica"],
        ["avatar", "levels", "--out", "out.pica"],
        ["send", "--avatar"],
        ["view", "--avatar"],
        ["demo", "--avatar"],
        ["bench", "decode", "--avatar"],
    ],
)
def test_every_command_knows_the_names_of_those_that_ship(
    words: list[str],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*words, "nobody"]) == 2
    known = "avatar 'nobody' is unknown; shipped are: ines, karim, mei, olav, sam"
    assert known in capsys.readouterr().err


def test_info_and_verify_take_a_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["avatar", "info", "sam"]) == main(["avatar", "verify", "Mei"]) == 0
    said = capsys.readouterr().err
    assert "name  Sam" in said
    assert "mei.pica: ok, " in said
