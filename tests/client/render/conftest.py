"""What tests of drawing share."""

from collections.abc import Iterator

import moderngl
import pytest

from pica_core.gl import create_context


@pytest.fixture(scope="module")
def context() -> Iterator[moderngl.Context]:
    """A GL context for the tests of a file."""
    made = create_context()
    yield made
    made.release()
