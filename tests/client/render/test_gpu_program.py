"""Messages about shaders point at our files."""

import pytest

from pica_client.render.gpu_program import complaint

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(
    "error",
    [
        "0:2(5): error: `x' undeclared",
        "0(2) : error C1503: undefined variable",
        "ERROR: 0:2: 'x' : undeclared",
    ],
    ids=["mesa", "nvidia", "apple"],
)
def test_a_drivers_message_is_told_with_the_line_that_it_complains_of(error: str) -> None:
    log = f"GLSL Compiler failed\n0:1(1): warning: dull\n{error}\n0:3(1): error: more\n"
    assert complaint(log, "first\n  x = 1;\nthird") == f"{error} in 'x = 1;'"


def test_a_message_without_errors_is_told_as_it_is() -> None:
    assert complaint(" out of registers \n", "text") == "out of registers"
