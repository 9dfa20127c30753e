"""``scripts/house.py`` and ``scripts/pages.py``: what is counted, written and run, and that the
commands of pages exist and say what is shown."""

import json
import re
from pathlib import Path

import pytest

from helpers.paths import ROOT, load_script
from pica_command.main import main

pytestmark = pytest.mark.unit

HOUSE, SCRIPT = load_script("house"), load_script("pages")
PAGES = ("README.md", "docs/quick-start.md", "docs/tutorial.md")
COMMAND_LINE = (ROOT / "docs" / "command-line.md").read_text()


def test_every_file_of_the_packages_has_a_room_and_nothing_imports_in_circles() -> None:
    counts = HOUSE.measure()
    assert sum(lines for lines, _ in counts["rooms"].values()) == counts["production_lines"]
    assert sum(budget for _, budget in counts["rooms"].values()) <= 42_600
    assert counts["circle"] == []
    assert counts["longest_file"] <= 500
    assert counts["largest_folder"] <= 20


def test_no_line_says_what_the_field_has_other_words_for() -> None:
    assert HOUSE.dialect() == []


def test_a_circle_is_found_however_far_around() -> None:
    found = HOUSE.circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}})
    assert set(found) == {"a", "b", "c"}


def test_the_page_is_what_its_script_writes() -> None:
    assert SCRIPT.command_line_page() == COMMAND_LINE


def test_the_errors_on_the_page_are_what_the_command_says(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["veiw"]) == main(["send", "--nme", "Ada"]) == 2
    assert capsys.readouterr().err in COMMAND_LINE
    shown = json.loads(re.search(r"^\{.*\}$", COMMAND_LINE, re.MULTILINE)[0])["error"]  # type: ignore[index]  # it is there
    assert main(["send", "--url", "ws://127.0.0.1:9", "--json"]) == 2
    said = json.loads(capsys.readouterr().out)["error"]
    assert said.keys() == shown.keys()
    assert {**said, "message": ""} == {**shown, "message": ""}


@pytest.mark.parametrize("name", PAGES)
def test_every_command_of_a_page_exists_with_its_options(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = list(SCRIPT.blocks_of((ROOT / name).read_text()))
    commands = [words for block in blocks for words in block.commands]
    assert len(commands) >= 7
    for words in commands:
        SCRIPT.check(words)


def test_a_page_says_how_its_blocks_are_run() -> None:
    page = (
        "```sh\npica doctor # x\n```\n## Next\n<!-- in the background -->\n```sh\npica relay\n```\n"
    )
    blocks = list(SCRIPT.blocks_of(page))
    assert [block.how for block in blocks] == ["", "heading", "in the background"]
    assert blocks[0].commands == [["doctor"]]
    with pytest.raises(ValueError, match="a block is marked 'sometimes'"):
        list(SCRIPT.blocks_of("<!-- sometimes -->\n```sh\nls\n```\n"))


def test_ci_runs_every_page() -> None:
    makefile = (ROOT / "Makefile").read_text()
    assert "make pages" in (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    assert f"scripts/pages.py {' '.join(PAGES)}\n" in makefile
