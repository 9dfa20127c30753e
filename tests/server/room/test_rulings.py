import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_server.room.rulings import (
    BAR,
    MAX_ROOMS,
    MAX_RULINGS,
    RULING_S,
    Ruling,
    Rulings,
    identity_key,
)

pytestmark = pytest.mark.unit

OPINIONS = st.dictionaries(
    st.tuples(st.sampled_from(["ada", "bob"]), st.sampled_from([BAR, "face"])),
    st.builds(Ruling, st.integers(0, 3), st.integers(1, 3), st.booleans()),
)


@given(st.lists(OPINIONS, max_size=4))
def test_nodes_that_learn_the_same_in_any_sequence_agree(
    opinions: list[dict[tuple[str, str], Ruling]],
) -> None:
    first, second = Rulings(float), Rulings(float)
    for each in opinions:
        first.learn("lobby", each)
    for each in reversed(opinions):
        second.learn("lobby", each)
    assert first.of("lobby") == second.of("lobby")
    assert not second.learn("lobby", first.of("lobby"))


def test_the_newer_opinion_counts_although_its_clock_is_behind() -> None:
    ahead, behind = Rulings(lambda: 1000.0), Rulings(lambda: 997.0)
    ahead.give("lobby", "ada", holds=True)
    behind.learn("lobby", ahead.of("lobby"))
    behind.give("lobby", "ada", holds=False)
    ahead.learn("lobby", behind.of("lobby"))
    assert not ahead.holds("lobby", "ada")
    assert ahead.of("lobby")[identity_key("ada"), BAR].ends_s == 1000 + RULING_S


def test_rulings_are_bounded_in_each_room_and_in_all() -> None:
    seconds = iter(range(1_000_000))
    rulings = Rulings(lambda: float(next(seconds)))
    for number in range(MAX_RULINGS + 10):
        rulings.give("lobby", f"p{number}", holds=True)
    assert len(rulings.of("lobby")) == MAX_RULINGS
    assert not rulings.holds("lobby", "p9")
    assert rulings.holds("lobby", "p10")
    for number in range(MAX_ROOMS):
        rulings.give(f"room{number}", "ada", holds=True)
    assert not rulings.of("lobby")
    assert rulings.holds("room0", "ada")
