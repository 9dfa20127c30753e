import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.strategies import names
from pica_client.call.roster import name_warnings
from pica_protocol.messages import Peer

pytestmark = pytest.mark.unit


def notes(*people: str | tuple[str, str], own: str = "") -> list[str]:
    """The warnings of people in order; one whose name is assured is (name, identity)."""
    peers = [
        Peer(peer_id=f"p{i}", name=who)
        if isinstance(who, str)
        else Peer(peer_id=f"p{i}", name=who[0], identity=who[1], is_name_assured=True)
        for i, who in enumerate(people)
    ]
    return list(name_warnings(peers, own).values())


def test_people_with_names_of_their_own_get_no_warning() -> None:
    assert notes("Ada", ("Bob", "bob-1"), "Zoë", "Zoe", "李明", own="Eve") == [""] * 5


@pytest.mark.parametrize(
    "like_ada",
    [
        "ada",
        " Ada",
        "A d a",
        "\u0410da",  # Cyrillic
        "\u0391da",  # Greek
        "Ad\u0430",
        "\uff21\uff44\uff41",  # full width
        "\U0001d400da",  # mathematical bold
        "Ada\u3164",  # a filler
        "Ada\u034f",  # a joiner
        "Ada\ufe0f",  # a variation selector
    ],
)
def test_a_name_that_looks_like_another_is_marked_with_whom_it_looks_like(like_ada: str) -> None:
    assert notes("Ada", like_ada) == [f"looks like {like_ada}", "looks like Ada"]
    assert notes(like_ada, own="Ada") == ["looks like your name"]


@pytest.mark.parametrize(("one", "other"), [("Ian", "lan"), ("Bob", "B0b"), ("Mom", "Morn")])
def test_letters_that_look_alike_within_a_script_are_found_too(one: str, other: str) -> None:
    assert notes(one, other) == [f"looks like {other}", f"looks like {one}"]


def test_of_two_with_one_name_both_are_marked_and_whoever_has_ours() -> None:
    assert notes("Ada", "Bob", "Ada") == ["also Ada", "", "also Ada"]
    assert notes("Ada", own="Ada") == ["has your name"]


def test_whose_name_alone_is_assured_is_not_suspected_and_the_others_are() -> None:
    assert notes(("Ada", "ada-1"), "Ada", "\u0410da") == [
        "",
        "not the assured Ada",
        "looks like the assured Ada",
    ]
    assert notes(("Ada", "ada-1"), ("Ada", "ada-2")) == ["also Ada", "also Ada"]


@given(names, st.lists(st.text("Al1I\u0410m\u034f ", min_size=1).filter(str.strip), max_size=3))
def test_whatever_a_name_is_made_of_its_like_is_found(name: str, others: list[str]) -> None:
    found = notes(name, *others, name)
    assert len(found) == len(others) + 2
    assert found[0]
    assert found[-1]
