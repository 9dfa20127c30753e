"""Names of shipped avatars stand for their files in every command that takes one."""

from pathlib import Path

import pytest

from pica_command.main import main
from pica_core.avatar.file import avatar_file, shipped_avatar_files, shipped_portraits
from pica_core.errors import AvatarFileError

pytestmark = pytest.mark.unit


def test_a_name_is_a_shipped_file_whatever_its_case_and_a_file_is_itself(tmp_path: Path) -> None:
    for path in shipped_avatar_files():
        assert avatar_file(Path(path.stem)) == avatar_file(Path(path.stem.title())) == path
    assert avatar_file(tmp_path / "me.pica") == tmp_path / "me.pica"
    with pytest.raises(AvatarFileError, match="avatar 'nobody' is unknown; shipped are: amara, "):
        avatar_file(Path("nobody"))


def test_a_folder_of_the_same_name_hides_no_avatar_and_an_unknown_home_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "nora").mkdir()

    assert avatar_file(Path("nora")).is_file()
    assert main(["avatar", "info", "~nobody-at-all/x.pica"]) == 2


def test_no_file_that_ships_has_more_than_four_million_bytes() -> None:
    assert all(path.stat().st_size <= 4_000_000 for path in shipped_avatar_files())


def test_a_small_picture_of_each_person_ships() -> None:
    people = {
        file.stem for file in (Path(__file__).parents[3] / "scripts" / "people").glob("*.json")
    }
    portraits = shipped_portraits()
    assert people <= portraits.keys()
    assert all(picture.stat().st_size <= 60_000 for picture in portraits.values())


@pytest.mark.parametrize(
    "words",
    [
        ["avatar", "info"],
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
    names = ", ".join(path.stem for path in shipped_avatar_files())
    known = f"avatar 'nobody' is unknown; shipped are: {names}"
    assert known in capsys.readouterr().err
