"""Good inputs of everything that reads bytes of strangers, whole and damaged."""

from importlib.util import find_spec

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzing.targets import TARGETS, damaged, seeds

pytestmark = pytest.mark.unit

SEEDS = seeds()
NAMES = [name for name in TARGETS if find_spec("av") or name not in ("film", "sound")]
QUICK = [name for name in NAMES if name != "head" or settings().max_examples > 1000]
"""A head takes half a second: damaged ones are for `make fuzz`."""


@pytest.mark.parametrize("name", NAMES)
def test_a_seed_is_accepted_or_refused_as_documented(name: str) -> None:
    assert SEEDS[name]
    for data in SEEDS[name]:
        TARGETS[name](data)


@pytest.mark.parametrize("name", QUICK)
@given(st.data())
def test_damaged_seeds_are_accepted_or_refused_as_documented(
    name: str, data: st.DataObject
) -> None:
    TARGETS[name](data.draw(damaged(name, SEEDS[name])))
