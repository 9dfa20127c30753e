"""Decide which relay has a room, from a bucket of keys that all relays share.

A room lives on one relay. The bucket has one key for each relay, its beat, renewed every `BEAT_S`,
and one for each room, the claim of the relay that has it. A claim holds for as long as its relay
beats; a relay that has been silent for `LEASE_S` is dead. A key is written only over the revision
that was read: of several relays that write at once one succeeds, and the others read again.

    the bucket names      the room is here           joins wait for it          neither
    this relay            keep                       admit                      remove the key
    a relay that beats    the better claim holds     redirect                   forget
    a relay that is late  keep                       wait                       forget
    one that is dead, or  take over                  take over                  forget
    draining
    no relay              claim                      claim for the relay of     forget
                                                     the fewest connections
    (no answer)           keep                       admit                      forget

The better claim is the one of the higher term, and of the same term the older one. Taking a room
over raises the term, so a relay that was cut off meanwhile gives way, and so does one that drains.
"""

import asyncio
import hashlib
import json
import logging
import secrets
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from typing import Final, TypeVar

from pica_protocol.limits import check_url
from pica_server.config import ConfigurationError
from pica_server.log import say
from pica_server.placement.bucket import AWAY, RECONNECT_S, TTL_S, Bucket
from pica_server.room.hub import Hub

BEAT_S: Final = 0.4
"""Between two beats of a relay (chosen: ten relays cost NATS 25 small writes a second)."""
LATE_S: Final = 0.7
"""A relay that has missed a beat is late: joins for its rooms wait until it is heard, or dead."""
LEASE_S: Final = 2.0
"""A relay that has been silent for so long is dead (chosen: participants are to be back in their
rooms within five seconds)."""
RESERVED_S: Final = 10.0
"""A claim without participants is kept for so long: they are being redirected (chosen)."""
REWRITE_S: Final = TTL_S / 3
"""A claim is written again after that."""
TICK_S: Final = 0.25
"""Between two looks at what waits."""
STOP_S: Final = 1.0
"""Seconds for removing the keys of this relay when it stops."""
_NUM_AT_ONCE: Final = 8
"""Rooms that are looked up in the bucket at once."""

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Beat:
    """The key of a relay."""

    relay: str
    url: str
    """Where clients reach it."""
    num_connections: int
    is_open: bool
    """Whether it takes new rooms."""
    is_draining: bool
    """Whether its rooms are to be taken over."""


@dataclass(frozen=True, slots=True)
class Claim:
    """The key of a room: the relay that has it."""

    relay: str
    term: int
    """How often the room was taken over."""
    since_ms: int
    """When it began, milliseconds since 1970."""

    @property
    def rank(self) -> tuple[int, int, str]:
        """The claim of the lower rank holds."""
        return -self.term, self.since_ms, self.relay


_Record = TypeVar("_Record", Beat, Claim)


@dataclass(slots=True)
class _Relay:
    beat: Beat
    heard_s: float
    load: int = 0
    """Connections of its last beat, and one for each room that this relay has placed on it since:
    participants are on their way."""


@dataclass(eq=False, slots=True)
class _Place:
    """One room that this relay has to do with."""

    key: str
    room: str = ""
    has_joins: bool = False
    """Joins wait for it."""
    own: Claim | None = None
    """The claim of this relay while the room is here."""
    reserved_until_s: float = 0.0
    written: bytes = b""
    """What this relay wrote to its key, at ``written_s``."""
    written_s: float = 0.0
    is_due: bool = False
    """It is to be looked at (again)."""
    task: "asyncio.Task[None] | None" = None


def room_key(room: str) -> str:
    """Return the key of a room, a hash of its name."""
    return "room." + hashlib.sha256(b"pica room\0" + room.encode()).hexdigest()[:32]


class RoomPlacement:
    """The rooms of one relay among all others.

    Attributes:
        is_up: Whether the bucket answers.
    """

    def __init__(
        self,
        bucket: Bucket,
        hub: Hub,
        on_placed: Callable[[str, str | None], None],
        unix_time: Callable[[], float],
    ) -> None:
        """Begin without the bucket.

        Args:
            hub: The hub whose rooms are placed.
            on_placed: Told a room, and the address of the relay that has it, "" if there is none;
                None: it is this one.
            unix_time: The clock of claims, seconds since 1970.
        """
        self.is_up = False
        self.me = secrets.token_hex(8)
        self._bucket = bucket
        self._hub = hub
        self._rooms = hub.membership.rooms
        self._counts = hub.stats.placement
        self._on_placed, self._unix_time = on_placed, unix_time
        self._url = ""
        self._revision: int | None = 0
        self._relays = {self.me: _Relay(Beat(self.me, "", 0, is_open=True, is_draining=False), 0.0)}
        self._places: dict[str, _Place] = {}  # as many as rooms here, joins and reservations
        self._ticked_s: float | None = None
        self._at_once = asyncio.Semaphore(_NUM_AT_ONCE)
        self._is_away = False  # what is said of it; the first line of a relay is another one
        self._tasks: list[asyncio.Task[None]] = []
        bucket.on_news, bucket.on_doubt, bucket.on_lost = self._take_news, self._doubt, self._lose

    async def start(self, url: str) -> None:
        """Connect to NATS; if it does not answer, go on trying.

        Args:
            url: Where clients reach this relay.

        Raises:
            ConfigurationError: NATS has no JetStream, or refuses this relay.
        """
        self._url = url
        with suppress(*AWAY):
            await self._bucket.connect()
            await self.renew()
        self._tasks = [asyncio.create_task(loop) for loop in (self._keep(), self._tick_on())]

    async def stop(self) -> None:
        """Remove the keys of this relay; the hub has closed its rooms before."""
        with suppress(*AWAY):
            async with asyncio.timeout(STOP_S):
                while tasks := [place.task for place in self._places.values() if place.task]:
                    await asyncio.wait(tasks)
                if self.is_up:
                    await self._bucket.write(f"relay.{self.me}", b"", None)
        tasks = [*self._tasks, *(place.task for place in self._places.values() if place.task)]
        self._tasks = []  # what ends from now on is no news
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self._bucket.close()

    def ask(self, room: str) -> None:
        """Find the relay of a room that is not here."""
        place = self._place(room)
        place.has_joins = True
        self._look(place)

    def note_started(self, room: str) -> None:
        """Note that a room has got its first peer here."""
        place = self._place(room)
        place.own = self._new_claim(self.me, 0)
        self._look(place)

    def note_ended(self, room: str) -> None:
        """Note that the last peer has left a room."""
        place = self._place(room)
        place.own, place.reserved_until_s = None, 0.0
        self._look(place)

    def refuge(self) -> str:
        """Return the address of another relay for the peers of a room, "" if there is none."""
        target = self._choose(self._relays.keys() - {self.me}) if self.is_up else None
        return "" if target is None else target.beat.url

    async def renew(self) -> None:
        """Write a beat over the last one; if that is missing, look at all rooms again."""
        hub, now = self._hub, self._now()
        is_draining = hub.connections.is_draining
        beat = Beat(self.me, self._url, hub.num_connections, hub.takes_rooms(now), is_draining)
        self._hear(beat, now)
        key, was_up = f"relay.{self.me}", self.is_up
        revision = await self._bucket.write(key, _encode(beat), self._revision)
        is_missing = revision is None
        if is_missing:
            revision = await self._bucket.write(key, _encode(beat), None)
        self._revision, self.is_up = revision, True
        if not was_up:
            for relay in self._relays.values():
                relay.heard_s = self._now()
        if is_missing or not was_up:
            self._doubt()
        if self._is_away:
            self._is_away = False
            say(_logger, "NATS answers", "NATS answers: rooms are placed on all relays")

    def tick(self) -> None:
        """Look at what is due; called every quarter of a second, or later if this relay stood
        still, and could not hear the others."""
        now = self._now()
        if self._ticked_s is not None and (gap_s := now - self._ticked_s) > 4 * TICK_S:
            for relay in self._relays.values():
                relay.heard_s += gap_s
        self._ticked_s = now
        forgotten = [name for name, r in self._relays.items() if now - r.heard_s > REWRITE_S]
        for name in set(forgotten) - {self.me}:
            del self._relays[name]
        for place in list(self._places.values()):
            is_here = place.room in self._rooms
            due_s = place.written_s + REWRITE_S if is_here else place.reserved_until_s
            if place.has_joins or now >= due_s:
                self._look(place)

    async def _keep(self) -> None:
        """Keep the connection and renew the beat until cancelled."""
        while True:
            await asyncio.sleep(BEAT_S if self.is_up else RECONNECT_S)
            try:
                if not self._bucket.is_connected:
                    await self._bucket.connect()
                elif not self.is_up:
                    await self._bucket.open()
                await self.renew()
            except (*AWAY, ConfigurationError):
                self._lose()

    async def _tick_on(self) -> None:
        while True:
            await asyncio.sleep(TICK_S)
            self.tick()

    def _lose(self) -> None:
        """Note that the bucket does not answer: rooms go on, and new ones are made here."""
        if self._tasks and not self._is_away:
            self._is_away = True
            spoken = "NATS does not answer: rooms go on, new ones are made where they are asked for"
            say(_logger, "NATS lost", spoken)
        self._counts["away"] += self.is_up
        self.is_up = False
        self._doubt()

    def _doubt(self) -> None:
        """Look at all rooms again: news may have been lost, or the bucket was made again."""
        for place in list(self._places.values()):
            self._look(place)

    def _take_news(self, key: str, data: bytes) -> None:
        """Take the data that was just written to a key."""
        now = self._now()
        if key.startswith("relay."):
            beat, relay = _decode(Beat, data), key.removeprefix("relay.")
            if beat is not None and beat.relay == relay:
                self._hear(beat, now)
            elif not data and relay != self.me:  # it has stopped
                self._relays.pop(relay, None)
            return
        claim, place = _decode(Claim, data), self._places.get(key)
        if place is None and claim is not None and claim.relay == self.me:
            place = self._places[key] = _Place(key, reserved_until_s=now + RESERVED_S)
        elif place is not None and data != place.written:
            self._look(place)

    def _hear(self, beat: Beat, now: float) -> None:
        relay = self._relays.setdefault(beat.relay, _Relay(beat, now))
        relay.beat, relay.heard_s, relay.load = beat, now, beat.num_connections

    def _look(self, place: _Place) -> None:
        """Have a room looked at, again if it is being looked at."""
        place.is_due = True
        if self.is_up and place.task is None:
            place.task = asyncio.create_task(self._settle(place))
        elif not self.is_up and place.has_joins:
            self._counts["local"] += 1
            self._let_in(place)

    async def _settle(self, place: _Place) -> None:
        """Bring a room and its key into line."""
        try:
            while place.is_due and self.is_up:
                place.is_due = False
                async with self._at_once:
                    await self._advance(place)
        except AWAY:
            pass  # the next tick tries again
        finally:
            place.task = None
            is_here = place.room in self._rooms
            if not (is_here or place.has_joins or self._now() < place.reserved_until_s):
                self._places.pop(place.key, None)

    async def _advance(self, place: _Place) -> None:
        """Do what the table of this module says; after a write the room is looked at again."""
        data, revision = await self._bucket.read(place.key)
        claim, now = _decode(Claim, data), self._now()
        is_here, what = place.room in self._rooms, "claimed"
        wanted: Claim | None = None
        if claim is None:
            if is_here:
                wanted = place.own
            elif place.has_joins:
                target = self._choose(self._relays) or self._relays[self.me]
                wanted = self._new_claim(target.beat.relay, 0)
        elif claim.relay == self.me:
            if place.has_joins:
                self._let_in(place)
            elif not is_here and now >= place.reserved_until_s:
                await self._bucket.write(place.key, b"", revision)
            elif is_here:
                place.own = claim
                wanted = claim if now - place.written_s >= REWRITE_S else None
        elif is_here or place.has_joins:
            # A relay that was never heard is dead some time from now.
            unknown = _Relay(
                Beat(claim.relay, "", 0, is_open=False, is_draining=False), now - LATE_S
            )
            relay = self._relays.setdefault(claim.relay, unknown)
            if relay.beat.is_draining or now - relay.heard_s >= LEASE_S:
                wanted, what = self._new_claim(self.me, claim.term + 1), "taken_over"
            elif is_here and place.own is not None and place.own.rank < claim.rank:
                wanted = place.own
            elif now - relay.heard_s < LATE_S:
                self._counts["redirected"] += 1
                place.has_joins = False
                self._on_placed(place.room, relay.beat.url)
        if wanted is not None:
            place.written, place.is_due = _encode(wanted), True
            if await self._bucket.write(place.key, place.written, revision) is not None:
                place.written_s = now
                self._counts[what] += 1

    def _choose(self, names: Iterable[str]) -> _Relay | None:
        """Place a room on the live relay with the lowest load that takes rooms; return it, or None
        if there is none."""
        now = self._now()
        relays = [self._relays[name] for name in sorted(names, key=lambda n: (n != self.me, n))]
        takers = [r for r in relays if r.beat.is_open and now - r.heard_s < LATE_S]
        target = min(takers, key=lambda relay: relay.load, default=None)
        if target is not None:
            target.load += 1
        return target

    def _let_in(self, place: _Place) -> None:
        place.has_joins, place.reserved_until_s = False, self._now() + RESERVED_S
        self._on_placed(place.room, None)

    def _place(self, room: str) -> _Place:
        key = room_key(room)
        place = self._places.setdefault(key, _Place(key))
        place.room = room
        return place

    def _new_claim(self, relay: str, term: int) -> Claim:
        return Claim(relay, term, round(self._unix_time() * 1000))

    def _now(self) -> float:
        return asyncio.get_running_loop().time()


def _encode(item: Beat | Claim) -> bytes:
    return json.dumps(asdict(item)).encode()


def _decode(kind: type[_Record], data: bytes) -> _Record | None:
    """Decode a beat or a claim; None if there is none, or it is malformed."""
    try:
        record = kind(**json.loads(data))
        check_url("url", getattr(record, "url", ""))
        is_sound = all(type(getattr(record, each.name)) is each.type for each in fields(kind))
    except (ValueError, TypeError):
        return None
    return record if is_sound else None
