"""Numbers out of range are refused, and None where nobody declared it."""

from dataclasses import dataclass

import pytest

from pica_core.errors import check_ranges

pytestmark = pytest.mark.unit


@dataclass(frozen=True)
class Options:
    steps: int = 4
    limit: float | None = None

    def __post_init__(self) -> None:
        check_ranges(self, steps=(1, 8), limit=(0, 1))


def test_numbers_in_range_and_unset_ones_are_taken() -> None:
    assert Options(steps=8, limit=0.5).limit == 0.5
    assert Options().limit is None


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"steps": 9}, "steps is 9; 1 to 8 is allowed"),
        ({"steps": None}, "steps is None; 1 to 8 is allowed"),
        ({"steps": float("nan")}, "steps is nan"),
        ({"limit": -0.5}, "limit is -0.5; 0 to 1 is allowed"),
    ],
)
def test_other_numbers_are_refused_by_name(changes: dict[str, float], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        Options(**changes)  # type: ignore[arg-type]
