"""What tests of captures share."""

from pathlib import Path

import pytest

from helpers.small_capture import TINY, render_capture


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture of the options `TINY`, to be read alone."""
    folder = tmp_path_factory.mktemp("rendered") / "S1"
    render_capture(TINY, folder)
    return folder
