"""Which relay gets a room: several `Placement`s over one bucket in memory, at literal times."""

from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pica_server.room.placement import (
    LATE_S,
    LEASE_S,
    RESERVED_S,
    REWRITE_S,
    Placement,
    Request,
    relay_key,
    room_key,
)
from pica_server.stats import RelayStats

pytestmark = pytest.mark.unit

KEY = room_key("lobby")


@dataclass
class Relay:
    """One relay: who is in its rooms follows what placement decides."""

    name: str
    since_s: float = 0.0
    """Of its clock, seconds since 1970."""
    load: int = 0
    rooms: set[str] = field(default_factory=set)
    requests: list[Request] = field(default_factory=list)
    redirects: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.stats = RelayStats()
        self.placement = Placement(
            self.name,
            self.rooms,
            self.stats,
            unix_time=lambda: self.since_s,
            request=self.requests.append,
        )

    @property
    def url(self) -> str:
        return f"ws://{self.name}:1"

    def follow(self, now: float) -> None:
        """Let people in, or send them where placement says."""
        for room, url in self.placement.take_events():
            if url is None:
                self.enter(room, now)
                continue
            self.redirects.append(url)
            if room in self.rooms:
                self.empty(room, now)

    def enter(self, room: str, now: float) -> None:
        self.rooms.add(room)
        self.placement.note_started(room, now)

    def empty(self, room: str, now: float) -> None:
        self.rooms.discard(room)
        self.placement.note_ended(room, now)


class Bucket:
    """Holds keys, and repeats each write to all relays that reach it."""

    def __init__(self, *relays: Relay) -> None:
        self.relays = relays
        self.entries: dict[str, tuple[bytes, int]] = {}
        self.revision = 0
        self.beat(*relays, now=0.0)

    def beat(self, *relays: Relay, now: float) -> None:
        for relay in relays:
            data = relay.placement.beat(relay.url, relay.load, is_open=True, now=now)
            self.put(relay_key(relay.name), data, now)
            relay.placement.receive_renewed(now)

    def put(self, key: str, data: bytes, now: float) -> None:
        self.revision += 1
        self.entries[key] = data, self.revision
        for relay in self.relays:
            if relay.placement.is_up or key.startswith("relay."):
                relay.placement.receive_news(key, data, now)

    def answer(self, relay: Relay, now: float) -> None:
        """Answer the oldest request of a relay."""
        key, data, revision = relay.requests.pop(0)
        before = self.entries.get(key, (b"", 0))
        found: tuple[bytes, int] | None = before
        if data is not None:
            found = None
            if before[1] == revision:
                self.put(key, data, now)
                found = self.entries[key] if data else None
        relay.placement.receive_answer(key, found, now)
        relay.follow(now)

    def settle(self, now: float) -> None:
        """Answer until nobody asks anything; retries have their time."""
        for step in range(5):
            for relay in self.relays:
                while relay.requests:
                    self.answer(relay, now)
                relay.placement.tick(now + step * 0.1)
                relay.follow(now)

    def silence(self, relay: Relay, since: float, until: float) -> None:
        """Have all others beat and tick for a while."""
        others = [each for each in self.relays if each is not relay]
        for step in range(1, round((until - since) / 0.25) + 1):
            now = since + step * 0.25
            self.beat(*others, now=now)
            for each in others:
                each.placement.tick(now)


def ask(relay: Relay, now: float, room: str = "lobby") -> None:
    relay.placement.ask(room, now)
    relay.follow(now)


def test_a_room_that_nobody_has_is_claimed_by_the_relay_that_is_asked_if_none_has_less_to_do() -> (
    None
):
    a, b = relays = Relay("a"), Relay("b")
    bucket = Bucket(*relays)
    ask(a, 0.1)
    assert a.rooms == set()
    bucket.settle(0.1)
    assert a.rooms == {"lobby"}
    assert b.rooms == set()


def test_a_room_that_nobody_has_goes_to_the_relay_with_the_fewest_connections() -> None:
    a, b = relays = Relay("a", load=5), Relay("b", load=3)
    bucket = Bucket(*relays)
    ask(a, 0.1)
    bucket.settle(0.1)
    assert a.redirects == [b.url]
    ask(b, 0.2)
    bucket.settle(0.2)
    assert b.rooms == {"lobby"}


def test_rooms_that_are_placed_before_the_next_beat_do_not_all_go_to_one_relay() -> None:
    a, b = relays = Relay("a", load=1), Relay("b")
    bucket = Bucket(*relays)
    for number in range(4):
        ask(a, 0.1, f"room{number}")
        bucket.settle(0.1)
    assert len(a.redirects) == 2 or len(a.rooms) == 2
    assert a.redirects
    assert a.rooms
    assert set(a.redirects) == {b.url}


@pytest.fixture
def pair() -> tuple[Relay, Relay, Bucket]:
    """Relay b has the lobby."""
    a, b = relays = Relay("a"), Relay("b")
    bucket = Bucket(*relays)
    ask(b, 0.1)
    bucket.settle(0.1)
    assert b.rooms == {"lobby"}
    return a, b, bucket


Pair = tuple[Relay, Relay, Bucket]


def test_joins_for_a_room_of_a_late_relay_wait_until_it_is_heard(pair: Pair) -> None:
    a, b, bucket = pair
    bucket.silence(b, 0.0, LATE_S + 0.5)
    ask(a, LATE_S + 0.5)
    bucket.answer(a, LATE_S + 0.5)
    assert (a.rooms, a.redirects) == (set(), [])
    bucket.beat(b, now=LATE_S + 0.6)
    a.placement.tick(LATE_S + 0.6)
    a.follow(LATE_S + 0.6)
    assert a.redirects == [b.url]


def test_a_room_of_a_dead_relay_is_taken_over_by_the_relay_that_is_asked(pair: Pair) -> None:
    a, b, bucket = pair
    bucket.silence(b, 0.0, LEASE_S)
    ask(a, LEASE_S)
    while a.requests:
        bucket.answer(a, LEASE_S)
    assert a.rooms == {"lobby"}
    assert a.stats.placement["taken_over"] == 1


def test_a_relay_that_was_taken_for_dead_sends_its_people_after_the_others(pair: Pair) -> None:
    a, b, bucket = pair
    bucket.silence(b, 0.0, LEASE_S)
    ask(a, LEASE_S)
    while a.requests:
        bucket.answer(a, LEASE_S)
    bucket.beat(a, b, now=LEASE_S + 0.1)
    bucket.settle(LEASE_S + 0.1)
    assert b.redirects == [a.url]
    assert (a.rooms, b.rooms) == ({"lobby"}, set())


def test_time_in_which_this_relay_stood_still_does_not_make_others_dead(pair: Pair) -> None:
    a, b, bucket = pair
    a.placement.tick(0.2)
    a.placement.tick(9.0)
    ask(a, 9.0)
    bucket.answer(a, 9.0)
    assert a.redirects == [b.url]


def test_the_key_of_a_room_goes_with_its_last_peer(pair: Pair) -> None:
    _, b, bucket = pair
    b.empty("lobby", 1.0)
    bucket.settle(1.0)
    assert bucket.entries[KEY][0] == b""


def test_a_room_to_which_nobody_comes_who_was_sent_is_given_up() -> None:
    a, b = relays = Relay("a", load=5), Relay("b")
    bucket = Bucket(*relays)
    ask(a, 0.1)
    bucket.settle(0.1)
    assert a.redirects == [b.url]
    bucket.settle(0.1 + RESERVED_S / 2)
    assert bucket.entries[KEY][0]
    bucket.settle(0.1 + RESERVED_S)
    assert bucket.entries[KEY][0] == b""


def test_a_claim_is_written_again_before_the_bucket_drops_it(pair: Pair) -> None:
    _, _, bucket = pair
    before = bucket.entries[KEY]
    bucket.settle(REWRITE_S + 1)
    assert bucket.entries[KEY][0] == before[0]
    assert bucket.entries[KEY][1] > before[1]


def test_without_the_bucket_rooms_are_made_where_they_are_asked_for() -> None:
    a = Relay("a")
    ask(a, 0.0)
    assert a.rooms == {"lobby"}
    assert a.stats.placement["local"] == 1


def test_a_join_that_waits_is_let_in_when_the_bucket_goes_away(pair: Pair) -> None:
    a, _, bucket = pair
    ask(a, 0.2)
    assert a.rooms == set()
    a.placement.receive_away(0.3)
    a.follow(0.3)
    assert a.rooms == {"lobby"}
    bucket.answer(a, 0.4)  # too late to change anything
    assert a.rooms == {"lobby"}


def test_a_bucket_that_comes_back_empty_is_filled_again_without_anybody_leaving(pair: Pair) -> None:
    a, b, bucket = pair
    for relay in (a, b):
        relay.placement.receive_away(1.0)
    bucket.entries.clear()
    bucket.revision = 0
    bucket.beat(a, b, now=2.0)
    bucket.settle(2.0)
    assert b.rooms == {"lobby"}
    assert b.redirects == []
    ask(a, 2.1)
    bucket.settle(2.1)
    assert a.redirects == [b.url]


@pytest.mark.parametrize("first", ["a", "b"])
def test_of_two_rooms_of_one_name_the_older_stays_whoever_writes_first(first: str) -> None:
    a, b = Relay("a", since_s=7.0), Relay("b", since_s=5.0)
    for relay in (a, b):
        ask(relay, 0.0)
    bucket = Bucket(*((a, b) if first == "a" else (b, a)))
    bucket.settle(0.1)
    assert (a.rooms, b.rooms) == (set(), {"lobby"})
    assert a.redirects == [b.url]


def test_a_room_is_handed_over_before_its_people_are_redirected(pair: Pair) -> None:
    a, b, bucket = pair
    assert b.placement.hand_over("lobby", 0.2)
    assert b.redirects == []
    bucket.settle(0.2)
    assert b.redirects == [a.url]
    ask(a, 0.3)
    assert a.rooms == {"lobby"}  # it knows already


def test_rooms_are_handed_over_to_several_relays() -> None:
    a, b, c = relays = Relay("a"), Relay("b", load=9), Relay("c")
    bucket = Bucket(*relays)
    b.load = 0
    for room in ("one", "two"):
        ask(b, 0.1, room)
    b.placement.receive_away(0.1)
    b.follow(0.1)
    bucket.beat(b, now=0.2)
    bucket.settle(0.2)
    assert b.rooms == {"one", "two"}
    assert all(b.placement.hand_over(room, 0.3) for room in ("one", "two"))
    bucket.settle(0.3)
    assert sorted(b.redirects) == [a.url, c.url]


def test_a_hand_over_that_the_bucket_does_not_see_ends_when_the_bucket_goes_away(
    pair: Pair,
) -> None:
    _, b, _ = pair
    assert b.placement.hand_over("lobby", 0.2)
    b.placement.receive_away(0.3)
    b.follow(0.3)
    assert b.redirects == [""]
    assert b.rooms == set()


@given(data=st.binary(max_size=200) | st.text().map(str.encode))
@pytest.mark.parametrize("key", [KEY, relay_key("b")])
def test_any_bytes_in_the_bucket_are_read_or_counted(key: str, data: bytes) -> None:
    a = Relay("a")
    bucket = Bucket(a)
    bucket.put(key, data, 0.1)
    ask(a, 0.1)
    bucket.settle(0.1)
    assert a.rooms == {"lobby"}


STEPS = st.lists(
    st.tuples(
        st.sampled_from(["ask", "empty", "again", "answer", "away", "beat", "wipe"]),
        st.integers(0, 2),
    ),
    max_size=60,
)


@settings(max_examples=200)
@given(steps=STEPS)
def test_whatever_happens_a_room_is_on_one_relay_when_all_is_calm_again(
    steps: list[tuple[str, int]],
) -> None:
    relays = [Relay(name, since_s=float(i)) for i, name in enumerate("abc")]
    bucket = Bucket(*relays)
    now = 0.0
    for what, index in steps:
        now, relay = now + 0.05, relays[index]
        match what:
            case "ask" if "lobby" not in relay.rooms:
                ask(relay, now)
            case "empty" if "lobby" in relay.rooms:
                relay.empty("lobby", now)
            case "again" if "lobby" in relay.rooms:
                relay.empty("lobby", now)
                relay.enter("lobby", now)
            case "answer" if relay.requests:
                bucket.answer(relay, now)
            case "away":
                relay.placement.receive_away(now)
            case "beat":
                bucket.beat(relay, now=now)
            case "wipe":
                bucket.entries.clear()
                for each in relays:
                    each.placement.doubt_all(now)
        relay.follow(now)
    for _ in range(3):
        now += 0.1
        bucket.beat(*relays, now=now)
        bucket.settle(now)
    having = [relay for relay in relays if relay.rooms]
    assert len(having) <= 1
    for relay in having:
        assert bucket.entries[KEY][0], relay
