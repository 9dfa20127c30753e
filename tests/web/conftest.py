"""One Node process for all tests of the page's modules."""

import shutil
import subprocess
from collections.abc import Iterator

import pytest

from helpers.page import PEER, Page


@pytest.fixture(scope="session")
def page() -> Iterator[Page]:
    """The modules of the page in Node."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    with subprocess.Popen(
        [node, "--no-warnings", str(PEER)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        yield Page(process)
        assert process.stdin is not None
        process.stdin.close()
