"""Pages for people: links that lead somewhere."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.paths import ROOT

pytestmark = pytest.mark.unit

PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "examples/*.md", "docker/**/*.md")
    for path in ROOT.glob(pattern)
)
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


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
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
