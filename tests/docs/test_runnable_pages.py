"""Pages that lead: each of their commands exists, and a script that CI runs does what they say."""

from pathlib import Path

import pytest

from helpers.paths import ROOT, load_script

pytestmark = pytest.mark.unit

PAGES = ("README.md", "docs/quick-start.md", "docs/tutorial.md")


SCRIPT = load_script("pages")


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
