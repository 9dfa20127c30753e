"""Each example runs, says something, warns of nothing and leaves its files where it is told.

Those that hold a call or follow a clock are in ``test_live_examples.py``: they run alone.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.examples import EXAMPLES, LIVE, assert_example_runs
from helpers.paths import ROOT

pytestmark = pytest.mark.train

OFFLINE = [path for path in EXAMPLES if path.stem[:2] not in LIVE]


@pytest.mark.parametrize("example", OFFLINE, ids=lambda path: path.stem)
def test_an_example_runs_without_a_warning(example: Path, tmp_path: Path) -> None:
    assert_example_runs(example, tmp_path)


def test_examples_are_numbered_short_and_say_what_one_learns() -> None:
    numbers = [int(path.stem.split("_")[0]) for path in EXAMPLES]
    assert numbers == list(range(1, len(EXAMPLES) + 1))
    for path in EXAMPLES:
        text = path.read_text()
        assert 20 <= len(text.splitlines()) <= 100, path.name
        assert "You learn" in text.partition('"""')[2].partition('"""')[0], path.name


def test_every_example_is_on_the_page_about_them() -> None:
    page = (ROOT / "examples" / "README.md").read_text()
    assert [path.name for path in EXAMPLES if f"[{path.name}]({path.name})" not in page] == []
