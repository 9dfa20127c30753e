"""Which relay gets a room: several relays over one bucket in memory, in virtual time."""

import asyncio
from contextlib import suppress
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pica_server.config import RelayConfig
from pica_server.placement.bucket import Bucket
from pica_server.placement.placement import (
    BEAT_S,
    LATE_S,
    LEASE_S,
    RESERVED_S,
    REWRITE_S,
    TICK_S,
    RoomPlacement,
    room_key,
)
from pica_server.room.hub import Hub
from pica_server.room.room import Room
from simnet.clock import in_virtual_time, run_virtual

pytestmark = pytest.mark.call

KEY = room_key("lobby")


@dataclass
class Store:
    """Keys with their revisions; repeats each write to all relays."""

    entries: dict[str, tuple[bytes, int]] = field(default_factory=dict)
    revision: int = 0
    buckets: list["FakeBucket"] = field(default_factory=list)

    def put(self, key: str, data: bytes) -> int:
        self.revision += 1
        self.entries[key] = data, self.revision
        for bucket in self.buckets:
            if bucket.is_connected:
                bucket.on_news(key, data)
        return self.revision

    @property
    def claimant(self) -> bytes:
        return self.entries.get(KEY, (b"", 0))[0]


class FakeBucket(Bucket):
    """A bucket without NATS; ``delay_s`` is what each request takes."""

    def __init__(self, store: Store) -> None:
        super().__init__("")
        self.store, self.is_cut, self.delay_s = store, False, 0.001
        store.buckets.append(self)

    @property
    def is_connected(self) -> bool:
        return not self.is_cut

    async def connect(self) -> None:
        await self._wait()

    async def open(self) -> None:
        await self._wait()

    async def close(self) -> None:
        self.is_cut = True

    async def read(self, key: str) -> tuple[bytes, int]:
        await self._wait()
        return self.store.entries.get(key, (b"", 0))

    async def write(self, key: str, data: bytes, revision: int | None) -> int | None:
        await self._wait()
        if revision is not None and revision != self.store.entries.get(key, (b"", 0))[1]:
            return None
        return self.store.put(key, data)

    async def _wait(self) -> None:
        await asyncio.sleep(self.delay_s)
        if self.is_cut:
            raise ConnectionError


class Relay:
    """One relay: who is in its rooms follows what placement decides."""

    def __init__(self, store: Store, since_s: float = 0.0, load: int = 0) -> None:
        self.hub = Hub(RelayConfig())
        for _ in range(load):
            self.hub.connect(0.0)
        self.rooms = self.hub.membership.rooms
        self.redirects: list[str] = []
        self.bucket = FakeBucket(store)
        self.placement = RoomPlacement(self.bucket, self.hub, self.follow, lambda: since_s)
        self.url = f"ws://r{len(store.buckets)}:1"

    def follow(self, room: str, url: str | None) -> None:
        if url is None:
            self.enter(room)
            return
        self.redirects.append(url)
        if room in self.rooms:
            self.empty(room)

    def enter(self, room: str = "lobby") -> None:
        if room not in self.rooms:
            self.rooms[room] = Room(room, 16)
            self.placement.note_started(room)

    def empty(self, room: str = "lobby") -> None:
        del self.rooms[room]
        self.placement.note_ended(room)

    async def cut(self, seconds: float = 0.05) -> None:
        """Lose the bucket for a while."""
        self.bucket.is_cut = True
        self.bucket.on_lost()
        await asyncio.sleep(seconds)

    def count(self, what: str) -> int:
        return self.hub.stats.placement[what]


@dataclass
class Cluster:
    """Relays that have started; ``kill`` ends one without a word."""

    store: Store = field(default_factory=Store)
    relays: list[Relay] = field(default_factory=list)

    async def start(self, *relays: Relay) -> None:
        self.relays += relays
        await asyncio.gather(*(relay.placement.start(relay.url) for relay in relays))

    async def two(self, **loads: int) -> tuple[Relay, Relay]:
        a, b = (Relay(self.store, load=loads.get(name, 0)) for name in "ab")
        await self.start(a, b)
        return a, b

    async def with_lobby_at_b(self) -> tuple[Relay, Relay]:
        a, b = await self.two()
        await ask(b)
        assert "lobby" in b.rooms
        return a, b

    def freeze(self, relay: Relay) -> None:
        """Let it beat and look no more."""
        for task in relay.placement._tasks:
            task.cancel()

    async def __aenter__(self) -> "Cluster":
        return self

    async def __aexit__(self, *_: object) -> None:
        for relay in self.relays:
            with suppress(asyncio.CancelledError):
                await relay.placement.stop()


async def ask(relay: Relay, room: str = "lobby", wait_s: float = 0.05) -> None:
    relay.placement.ask(room)
    await asyncio.sleep(wait_s)


@in_virtual_time
async def test_a_room_goes_to_the_relay_with_the_fewest_connections() -> None:
    async with Cluster() as cluster:
        a, b = await cluster.two(a=5, b=3)
        await ask(a)
        assert a.redirects == [b.url]
        await ask(b)
        assert list(b.rooms) == ["lobby"]


@in_virtual_time
async def test_joins_for_a_room_of_a_late_relay_wait_until_it_is_heard() -> None:
    async with Cluster() as cluster:
        a, b = await cluster.with_lobby_at_b()
        cluster.freeze(b)
        await asyncio.sleep(BEAT_S + LATE_S)
        await ask(a)
        assert (list(a.rooms), a.redirects) == ([], [])
        await b.placement.renew()
        await asyncio.sleep(TICK_S + 0.05)
        assert a.redirects == [b.url]


@in_virtual_time
async def test_a_room_of_a_dead_relay_is_taken_over_and_its_people_follow_if_it_lives() -> None:
    async with Cluster() as cluster:
        a, b = await cluster.with_lobby_at_b()
        cluster.freeze(b)
        await asyncio.sleep(BEAT_S + LEASE_S)
        await ask(a)
        assert list(a.rooms) == ["lobby"]
        assert a.count("taken_over") == 1
        b.placement.tick()
        await asyncio.sleep(0.05)
        assert b.redirects == [a.url]
        assert (list(a.rooms), list(b.rooms)) == (["lobby"], [])


@in_virtual_time
async def test_time_in_which_this_relay_stood_still_does_not_make_others_dead() -> None:
    async with Cluster() as cluster:
        a, b = await cluster.with_lobby_at_b()
        await asyncio.sleep(TICK_S)
        cluster.freeze(a)
        cluster.freeze(b)
        await asyncio.sleep(9.0)
        a.placement.tick()
        await ask(a)
        assert a.redirects == [b.url]


@in_virtual_time
async def test_the_key_of_a_room_goes_with_its_last_peer() -> None:
    async with Cluster() as cluster:
        _, b = await cluster.with_lobby_at_b()
        assert cluster.store.claimant
        b.empty()
        await asyncio.sleep(0.05)
        assert not cluster.store.claimant


@in_virtual_time
async def test_a_room_to_which_nobody_comes_who_was_sent_is_given_up() -> None:
    async with Cluster() as cluster:
        a, b = await cluster.two(a=5)
        await ask(a)
        assert a.redirects == [b.url]
        await asyncio.sleep(RESERVED_S / 2)
        assert cluster.store.claimant
        await asyncio.sleep(RESERVED_S / 2 + TICK_S)
        assert not cluster.store.claimant


@in_virtual_time
async def test_a_claim_is_written_again_before_the_bucket_drops_it() -> None:
    async with Cluster() as cluster:
        await cluster.with_lobby_at_b()
        data, revision = cluster.store.entries[KEY]
        await asyncio.sleep(REWRITE_S + 1)
        assert cluster.store.entries[KEY][0] == data
        assert cluster.store.entries[KEY][1] > revision


@in_virtual_time
async def test_without_the_bucket_rooms_are_made_where_they_are_asked_for() -> None:
    a = Relay(Store())
    a.placement.ask("lobby")
    assert list(a.rooms) == ["lobby"]
    assert a.count("local") == 1


@pytest.mark.parametrize("is_late", [False, True])
@in_virtual_time
async def test_of_two_rooms_of_one_name_the_older_stays_whoever_writes_first(is_late: bool) -> None:
    async with Cluster() as cluster:
        a, b = Relay(cluster.store, since_s=7.0), Relay(cluster.store, since_s=5.0)
        for relay in (a, b):
            relay.placement.ask("lobby")
        (b if is_late else a).bucket.delay_s = 0.02
        await cluster.start(a, b)
        await asyncio.sleep(0.5)
        assert (list(a.rooms), list(b.rooms)) == ([], ["lobby"])
        assert a.redirects == [b.url]


@in_virtual_time
async def test_a_room_of_a_draining_relay_is_taken_over_and_its_people_follow() -> None:
    async with Cluster() as cluster:
        a, b = await cluster.with_lobby_at_b()
        b.hub.connections.is_draining = True
        assert b.placement.refuge() == a.url
        await asyncio.sleep(BEAT_S + 0.05)
        await ask(a)
        assert b.redirects == [a.url]
        assert (list(a.rooms), list(b.rooms)) == (["lobby"], [])


@settings(deadline=None)
@given(data=st.binary(max_size=200) | st.text().map(str.encode))
@pytest.mark.parametrize("key", [KEY, "relay.b"])
def test_any_bytes_in_the_bucket_are_no_claim(key: str, data: bytes) -> None:
    async def test() -> None:
        async with Cluster() as cluster:
            a = Relay(cluster.store)
            await cluster.start(a)
            cluster.store.put(key, data)
            await ask(a)
            assert list(a.rooms) == ["lobby"]

    run_virtual(test())


STEPS = st.lists(
    st.tuples(
        st.sampled_from(["ask", "empty", "again", "wait", "cut", "mend", "wipe"]), st.integers(0, 2)
    ),
    max_size=40,
)


@settings(max_examples=60, deadline=None)
@given(steps=STEPS)
def test_whatever_happens_a_room_is_on_one_relay_when_all_is_calm_again(
    steps: list[tuple[str, int]],
) -> None:
    async def test() -> None:
        async with Cluster() as cluster:
            store = cluster.store
            relays = [Relay(store, since_s=float(i)) for i in range(3)]
            await cluster.start(*relays)
            for what, index in steps:
                relay = relays[index]
                match what:
                    case "ask" if not relay.rooms:
                        relay.placement.ask("lobby")
                    case "empty" if relay.rooms:
                        relay.empty()
                    case "again" if relay.rooms:
                        relay.empty()
                        relay.enter()
                    case "wait":
                        await asyncio.sleep(0.0015 * (1 + index))
                    case "cut":
                        await relay.cut(0.0)
                    case "mend":
                        relay.bucket.is_cut = False
                    case "wipe":
                        store.entries.clear()
            for relay in relays:
                relay.bucket.is_cut = False
            await asyncio.sleep(LEASE_S + 2)
            having = [relay for relay in relays if relay.rooms]
            assert len(having) <= 1
            assert all(relay.placement.me.encode() in store.claimant for relay in having)

    run_virtual(test())
