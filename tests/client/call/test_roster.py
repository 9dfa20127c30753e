"""Who is in the room and in which order, whatever becomes of the connection, and what is news."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers import strategies
from pica_client.call.roster import LEFT_IS_NEWS_AFTER_S, PLACE_IS_KEPT_S, Roster, name_warnings
from pica_protocol.messages import Joined, Peer, PeerAway, PeerJoined, PeerLeft, PeerUpdated, Track
from pica_protocol.session import Closed

pytestmark = pytest.mark.unit

CLOSED = Closed(code=1006, reason="", is_remote=True)
RECORDS = (("records", "yes"),)


def person(peer_id: str, name: str, *, stream: int = 1, avatar: str = "a" * 64) -> Peer:
    track = Track(kind="face", avatar=avatar, stream=stream)
    return Peer(peer_id=peer_id, name=name, tracks=(track,))


def watcher(peer_id: str, name: str) -> Peer:
    return Peer(peer_id=peer_id, name=name)


def joined(*peers: Peer, resumed: bool = False) -> Joined:
    return Joined(room="r", peer_id="me", peers=peers, resumed=resumed)


def names(roster: Roster) -> list[str]:
    return [member.peer.name for member in roster.members]


def news(roster: Roster) -> list[tuple[str, str]]:
    return [(each.kind, each.name) for each in roster.take_news()]


@pytest.fixture
def roster() -> Roster:
    """We come into a room with Ada, who shows a face, and Ben, who watches."""
    roster = Roster()
    roster.receive_event(joined(person("p1", "Ada"), watcher("p2", "Ben")), now=10.0)
    return roster


def test_those_who_only_watch_are_in_the_list(roster: Roster) -> None:
    assert [(each.peer.name, each.is_watching) for each in roster.members] == [
        ("Ada", False),
        ("Ben", True),
    ]


def test_who_was_there_before_us_is_no_news_and_who_comes_and_goes_is(roster: Roster) -> None:
    assert news(roster) == []
    roster.receive_event(PeerJoined(peer=person("p3", "Cho")), now=11.0)
    roster.receive_event(PeerLeft(peer_id="p1"), now=12.0)
    assert names(roster) == ["Ben", "Cho"]
    assert news(roster) == [("joined", "Cho"), ("left", "Ada")]
    assert news(roster) == []


def test_a_connection_that_is_soon_back_is_not_worth_a_word(roster: Roster) -> None:
    roster.receive_event(PeerAway(peer_id="p1", is_away=True), now=11.0)
    roster.handle_timer(12.0)
    assert roster.members[0].is_away
    roster.receive_event(PeerAway(peer_id="p1", is_away=False), now=12.5)
    roster.handle_timer(20.0)
    assert news(roster) == []
    assert not roster.members[0].is_away


def test_who_is_away_for_longer_is_said_to_be_and_to_be_back(roster: Roster) -> None:
    roster.receive_event(PeerAway(peer_id="p1", is_away=True), now=11.0)
    roster.handle_timer(13.0)
    roster.handle_timer(14.0)
    roster.receive_event(PeerAway(peer_id="p1", is_away=False), now=15.0)
    assert news(roster) == [("away", "Ada"), ("back", "Ada")]


def test_nobody_swaps_places_when_a_relay_that_starts_again_deals_new_ids(roster: Roster) -> None:
    roster.receive_event(PeerJoined(peer=person("p3", "Cho")), now=11.0)
    news(roster)
    roster.receive_event(CLOSED, now=20.0)
    roster.receive_event(joined(person("p1", "Cho", stream=1)), now=21.0)
    roster.receive_event(PeerJoined(peer=person("p3", "Ada", stream=9)), now=22.0)
    roster.receive_event(PeerJoined(peer=person("p4", "Dee")), now=22.0)
    roster.receive_event(PeerJoined(peer=watcher("p5", "Ben")), now=23.0)
    assert names(roster) == ["Ada", "Ben", "Cho", "Dee"]
    roster.handle_timer(99.0)
    assert news(roster) == [("joined", "Dee")]


def test_who_does_not_come_back_after_a_while_has_left(roster: Roster) -> None:
    roster.receive_event(CLOSED, now=20.0)
    roster.receive_event(joined(person("p1", "Ada")), now=21.0)
    roster.handle_timer(21.0 + LEFT_IS_NEWS_AFTER_S - 0.1)
    assert news(roster) == []
    roster.handle_timer(21.0 + LEFT_IS_NEWS_AFTER_S)
    assert news(roster) == [("left", "Ben")]


def test_two_of_one_name_and_avatar_have_a_place_each_after_a_restart() -> None:
    roster = Roster()
    roster.receive_event(joined(person("p1", "Ada"), person("p2", "Ada", stream=2)), now=0.0)
    roster.receive_event(CLOSED, now=1.0)
    roster.receive_event(joined(), now=2.0)
    roster.receive_event(PeerJoined(peer=person("p7", "Ada", stream=3)), now=3.0)
    roster.receive_event(PeerJoined(peer=person("p8", "Ada", stream=4)), now=3.0)
    assert len({member.place for member in roster.members}) == 2
    assert news(roster) == []


def test_who_left_and_comes_again_sits_where_they_sat_but_not_for_ever(roster: Roster) -> None:
    for away_s, place in ((PLACE_IS_KEPT_S - 1.0, 0), (PLACE_IS_KEPT_S + 1.0, 2)):
        (ada,) = (each.peer.peer_id for each in roster.members if each.peer.name == "Ada")
        roster.receive_event(PeerLeft(peer_id=ada), now=20.0)
        roster.handle_timer(20.0 + away_s)
        roster.receive_event(PeerJoined(peer=person(f"p{away_s}", "Ada", avatar="b" * 64)), 200.0)
        assert news(roster) == [("left", "Ada"), ("joined", "Ada")]
        assert roster.member(f"p{away_s}").place == place


def test_of_two_people_of_one_name_each_finds_the_place_of_their_avatar() -> None:
    roster = Roster()
    ada, other = person("p1", "Ada", avatar="a" * 64), person("p2", "Ada", avatar="b" * 64)
    roster.receive_event(joined(ada, other), now=0.0)
    roster.receive_event(CLOSED, now=1.0)
    roster.receive_event(joined(), now=2.0)
    for peer_id, avatar in (("p8", "b"), ("p9", "a")):
        roster.receive_event(PeerJoined(peer=person(peer_id, "Ada", avatar=avatar * 64)), now=3.0)
    assert [roster.member(peer_id).place for peer_id in ("p9", "p8")] == [0, 1]


def test_back_in_the_old_place_ids_mean_whom_they_meant(roster: Roster) -> None:
    roster.receive_event(CLOSED, now=20.0)
    roster.receive_event(joined(person("p3", "Cho"), person("p1", "Ada"), resumed=True), now=22.0)
    assert roster.joined_s == 10.0
    assert names(roster) == ["Ada", "Cho"]
    assert news(roster) == [("left", "Ben"), ("joined", "Cho")]


def test_who_records_is_said_at_once_and_to_who_comes_later() -> None:
    roster = Roster()
    ben = Peer(peer_id="p2", name="Ben", metadata=RECORDS)
    roster.receive_event(joined(person("p1", "Ada"), ben), now=0.0)
    assert news(roster) == [("records", "Ben")]
    assert [member.is_recording for member in roster.members] == [False, True]
    roster.receive_event(PeerUpdated(peer_id="p1", metadata=RECORDS), now=1.0)
    roster.receive_event(PeerUpdated(peer_id="p1", metadata=RECORDS), now=2.0)
    roster.receive_event(PeerUpdated(peer_id="p2"), now=3.0)
    assert news(roster) == [("records", "Ada"), ("records no more", "Ben")]


def test_what_nobody_takes_does_not_pile_up(roster: Roster) -> None:
    for index in range(500):
        peer_id = f"x{index}"
        roster.receive_event(PeerJoined(peer=watcher(peer_id, "Eve")), now=11.0)
        roster.receive_event(PeerLeft(peer_id=peer_id), now=11.0)
    assert len(news(roster)) == 64


def test_what_comes_of_peers_who_are_not_here_is_ignored(roster: Roster) -> None:
    for event in (
        PeerLeft(peer_id="x"),
        PeerAway(peer_id="x", is_away=True),
        PeerAway(peer_id="x", is_away=False),
    ):
        roster.receive_event(event, now=11.0)
    roster.receive_event(PeerUpdated(peer_id="x", metadata=RECORDS), now=11.0)
    roster.handle_timer(99.0)
    assert names(roster) == ["Ada", "Ben"]
    assert news(roster) == []


# Names that look alike


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
        "Ada (host)",
        "Ada - host",
        "[Ada]",
        "\u1d00\u1d05\u1d00",  # small capitals
        "\U0001f170da \u2605",  # a letter in a square, and a star
    ],
)
def test_a_name_that_looks_like_another_is_marked_with_whom_it_looks_like(like_ada: str) -> None:
    assert notes("Ada", like_ada) == [f"looks like {like_ada}", "looks like Ada"]
    assert notes(like_ada, own="Ada") == ["looks like your name"]


@pytest.mark.parametrize(
    ("one", "other"), [("Ian", "lan"), ("Bob", "B0b"), ("Bob", "8ob"), ("Mom", "Morn")]
)
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


@given(
    strategies.names,
    st.lists(st.text("Al1I\u0410m\u034f ", min_size=1).filter(str.strip), max_size=3),
)
def test_whatever_a_name_is_made_of_its_like_is_found(name: str, others: list[str]) -> None:
    found = notes(name, *others, name)
    assert len(found) == len(others) + 2
    assert found[0]
    assert found[-1]
