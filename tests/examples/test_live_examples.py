"""Each example that holds a call or follows a clock runs and warns of nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.examples import EXAMPLES, LIVE, assert_example_runs

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize(
    "example",
    [path for path in EXAMPLES if path.stem[:2] in LIVE],
    ids=lambda path: path.stem,
)
def test_an_example_runs_without_a_warning(example: Path, tmp_path: Path) -> None:
    assert_example_runs(example, tmp_path)
