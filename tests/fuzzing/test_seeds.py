"""Every seed of the coverage-guided targets, and what was found with them, on every run."""

import random

import pytest

from fuzzing.byte_targets import TARGETS, seeds
from fuzzing.mutator import Mutator

pytestmark = pytest.mark.unit

CASES = [(name, file, data) for name in TARGETS for file, data in seeds(name)]


@pytest.mark.parametrize(
    ("name", "data"), [case[::2] for case in CASES], ids=[f"{n}/{f}" for n, f, _ in CASES]
)
def test_a_seed_is_accepted_or_refused_as_documented(name: str, data: bytes) -> None:
    TARGETS[name](data)


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_seeds_are_accepted_or_refused_as_documented(name: str) -> None:
    rng = random.Random(name)
    inputs = [data for _, data in seeds(name)]
    assert inputs
    assert sum(map(len, inputs)) < 40_000, "the corpus stays small"
    mutator = Mutator(rng, inputs)
    for _ in range(100):
        TARGETS[name](mutator.mutate_bytes(rng.choice(inputs)))
