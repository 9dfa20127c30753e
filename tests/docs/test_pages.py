"""Pages: links lead somewhere, commands exist and say what is shown; and what `scripts/house.py`
counts."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.paths import ROOT, load_script
from pica_command.main import main

pytestmark = pytest.mark.unit

HOUSE, SCRIPT = load_script("house"), load_script("pages")
PAGES = ("README.md", "docs/quick-start.md", "docs/tutorial.md", "docs/own-head.md")
ALL_PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "examples/*.md", "docker/**/*.md")
    for path in ROOT.glob(pattern)
)
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


@pytest.mark.slow
def test_the_page_is_what_its_script_writes() -> None:
    assert SCRIPT.command_line_page() == COMMAND_LINE


@pytest.mark.slow
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


# Links


LINK = re.compile(r"\]\(([^)\s]+)\)")


def prose(text: str) -> str:
    """The text without fenced blocks, indented blocks and `code`: what may hold links."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"^    [^ -].*$", "", text, flags=re.MULTILINE)
    return re.sub(r"`[^`\n]*`", "`code`", text)


def anchors(text: str) -> set[str]:
    """What links to headings of a page are called."""
    headings = re.findall(r"^#+ +(.*)$", text, flags=re.MULTILINE)
    kept = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.replace(" ", "-") for heading in kept}


def dead_links(path: Path, text: str) -> Iterator[str]:
    """Links of a page to files or headings that are not there; those to other sites are skipped."""
    for target in LINK.findall(prose(text)):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        page = path.parent / name if name else path
        has_heading = not anchor or page.suffix != ".md"
        if not page.exists() or not (has_heading or anchor in anchors(page.read_text())):
            yield target


@pytest.mark.parametrize("path", ALL_PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_page_has_no_dead_link(path: Path) -> None:
    assert list(dead_links(path, path.read_text())) == []


def test_dead_links_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    text = "# A `b` heading\n\n[x](page.md#a-b-heading) [y](none.md) [z](#gone)\n"
    page.write_text(text)
    assert list(dead_links(page, text)) == ["none.md", "#gone"]


def test_every_page_of_the_documentation_is_on_its_front_page() -> None:
    front = (ROOT / "docs" / "README.md").read_text()
    listed = set(LINK.findall(front))
    pages = {path.name for path in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert pages - listed == set()
