"""The security page names tests: they must be there."""

import re

import pytest

from helpers.paths import ROOT

pytestmark = pytest.mark.unit

PAGE = (ROOT / "docs" / "security.md").read_text()
NAMED = sorted(set(re.findall(r"`(test_[a-z0-9_]+)`", PAGE)))
DEFINED = {
    name
    for path in (ROOT / "tests").rglob("test_*.py")
    for name in re.findall(r"^(?:async )?def (test_[a-z0-9_]+)", path.read_text(), re.MULTILINE)
}


@pytest.mark.parametrize("name", NAMED)
def test_every_test_that_the_security_page_names_exists(name: str) -> None:
    assert name in DEFINED


def test_every_row_of_the_security_page_names_a_test() -> None:
    rows = [line for line in PAGE.splitlines() if line.startswith("| ")][1:]
    assert len(rows) > 10
    assert all("`test_" in row for row in rows)
