"""Decide which relay has a room, from a bucket of keys that all relays share. Pure.

A room lives on one relay. The bucket has one key for each relay, its beat, renewed every `BEAT_S`,
and one for each room, the claim of the relay that has it. A claim holds for as long as its relay
beats; a relay that has been silent for `LEASE_S` is dead. A key is written only over the revision
that was read: of several relays that write at once one succeeds, and the others read again.

    the bucket names      the room is here           joins wait for it          neither
    this relay            keep, or hand over         admit                      remove the key
    a relay that beats    the better claim holds     redirect                   forget
    a relay that is late  keep                       wait                       forget
    a dead relay          take over                  take over                  forget
    no relay              claim                      claim for the relay of     forget
                                                     the fewest connections
    (no answer)           keep                       admit                      forget

The better claim is the one of the higher term, and of the same term the older one. Taking a room
over or handing it over raises the term, so a relay that was cut off meanwhile gives way.
"""

import hashlib
import json
from collections.abc import Callable, Container, Iterable
from dataclasses import asdict, dataclass, field, fields
from typing import Final, NamedTuple, TypeVar

from pica_protocol.limits import check_url
from pica_server.stats import RelayStats

BEAT_S: Final = 0.4
"""Between two beats of a relay (chosen: ten relays cost NATS 25 small writes a second)."""
LATE_S: Final = 0.7
"""A relay that has missed a beat is late: joins for its rooms wait until it is heard, or dead."""
LEASE_S: Final = 2.0
"""A relay that has been silent for so long is dead (chosen: participants are to be back in their
rooms within five seconds)."""
FRESH_S: Final = 2.0
"""A room that was placed on a relay counts as one of its connections for so long, beside those of
its beats: its participants are on their way (chosen)."""
RESERVED_S: Final = 10.0
"""A claim without participants is kept for so long: they are being redirected (chosen)."""
REWRITE_S: Final = 200.0
"""A claim is written again after that; the bucket drops keys that are three times as old."""
RETRY_S: Final = 0.1
"""Wait between a request that failed and reading the key again (chosen)."""
_GAP_S: Final = 1.0
"""Time without a tick in which this relay stood still, and could not hear the others."""


@dataclass(frozen=True, slots=True)
class Beat:
    """The key of a relay."""

    relay: str
    url: str
    """Where clients reach it."""
    num_connections: int
    is_open: bool
    """Whether it takes new rooms."""


@dataclass(frozen=True, slots=True)
class Claim:
    """The key of a room: the relay that has it."""

    relay: str
    term: int
    """How often the room was taken over or handed over."""
    since_ms: int
    """When it began, milliseconds since 1970."""

    @property
    def rank(self) -> tuple[int, int, str]:
        """The claim of the lower rank holds."""
        return -self.term, self.since_ms, self.relay


class Request(NamedTuple):
    """Read a key, or write it over a revision."""

    key: str
    data: bytes | None = None
    """None reads the key, and empty data removes it."""
    revision: int = 0


class Placed(NamedTuple):
    """The relay of a room is found: joins that wait are admitted, or redirected with its peers."""

    room: str
    url: str | None
    """Address of the other relay, "" if there is none; None: this relay has the room."""


_Record = TypeVar("_Record", Beat, Claim)


@dataclass(slots=True)
class _Relay:
    beat: Beat
    heard_s: float
    placed_s: list[float] = field(default_factory=list)
    """When this relay placed rooms on it lately."""

    def load(self, now: float) -> int:
        """Return how many connections it has, or will have soon."""
        self.placed_s = [at_s for at_s in self.placed_s if now - at_s < FRESH_S]
        return self.beat.num_connections + len(self.placed_s)


@dataclass(slots=True)
class _Place:
    """One room that this relay has to do with."""

    key: str
    room: str = ""
    has_joins: bool = False
    """Joins wait for it."""
    own: Claim | None = None
    """The claim of this relay while the room is here."""
    known: tuple[Claim | None, int] | None = None
    """The claim in the bucket and its revision; None: it must be read."""
    reserved_until_s: float = 0.0
    written_s: float = 0.0
    retry_s: float = 0.0
    request: Request | None = None
    """The request that has no answer yet."""
    is_overtaken: bool = False
    """The key has changed since the request was made."""
    leaves_to: str = ""
    """The relay that the room is handed over to."""


def room_key(room: str) -> str:
    """Return the key of a room, a hash of its name."""
    return "room." + hashlib.sha256(b"pica room\0" + room.encode()).hexdigest()[:32]


def relay_key(relay: str) -> str:
    """Return the key of a relay."""
    return f"relay.{relay}"


class Placement:
    """The rooms of one relay among all others.

    Attributes:
        is_up: Whether the bucket answers.
    """

    def __init__(
        self,
        me: str,
        rooms: Container[str],
        stats: RelayStats,
        *,
        unix_time: Callable[[], float],
        request: Callable[[Request], None],
    ) -> None:
        """Begin without the bucket.

        Args:
            me: The id of this relay, another one for each run.
            rooms: The rooms with peers on this relay, now and later.
            unix_time: The clock of claims, seconds since 1970.
            request: Takes a request, to be answered once by ``receive_answer``.
        """
        self.is_up = False
        self._me = me
        self._relays: dict[str, _Relay] = {me: _Relay(Beat(me, "", 0, is_open=True), 0.0)}
        self._rooms = rooms
        self._counts = stats.placement
        self._unix_time = unix_time
        self._make_request = request
        self._places: dict[str, _Place] = {}  # as many as rooms here, joins and reservations
        self._events: list[Placed] = []
        self._ticked_s: float | None = None

    def num_relays(self, now: float) -> int:
        """Return how many relays are alive, this one among them."""
        return sum(now - each.heard_s < LEASE_S for each in self._relays.values())

    def ask(self, room: str, now: float) -> None:
        """Find the relay of a room that is not here; ``Placed`` follows."""
        place = self._place(room)
        place.has_joins = True
        self._advance(place, now)

    def note_started(self, room: str, now: float) -> None:
        """Note that a room has got its first peer here."""
        place = self._place(room)
        place.own = self._new_claim(self._me, 0)
        self._advance(place, now)

    def note_ended(self, room: str, now: float) -> None:
        """Note that the last peer has left a room."""
        place = self._places.get(room_key(room))
        if place is not None:
            place.own, place.leaves_to, place.reserved_until_s = None, "", 0.0
            self._advance(place, now)

    def hand_over(self, room: str, now: float) -> bool:
        """Hand a room over to another relay; ``Placed`` follows. Return False if there is none."""
        place = self._places.get(room_key(room))
        target = self._choose(self._relays.keys() - {self._me}, now)
        if place is None or target is None or not self.is_up:
            return False
        target.placed_s.append(now)
        place.leaves_to = target.beat.relay
        self._advance(place, now)
        return True

    def beat(self, url: str, num_connections: int, *, is_open: bool, now: float) -> bytes:
        """Return the beat of this relay."""
        beat = Beat(self._me, url, num_connections, is_open)
        self._hear(beat, now)
        return _encode(beat)

    def _hear(self, beat: Beat, now: float) -> None:
        relay = self._relays.setdefault(beat.relay, _Relay(beat, now))
        relay.beat, relay.heard_s = beat, now

    def receive_renewed(self, now: float) -> None:
        """Note that a beat was written; if the bucket was away, read all keys again."""
        if not self.is_up:
            self.is_up = True
            for relay in self._relays.values():
                relay.heard_s = now
            self.doubt_all(now)

    def receive_away(self, now: float) -> None:
        """Note that the bucket does not answer: rooms go on, and new ones are made here."""
        self._counts["away"] += self.is_up
        self.is_up = False
        for place in list(self._places.values()):
            self._advance(place, now)

    def doubt_all(self, now: float) -> None:
        """Read all keys again: news may have been lost, or the bucket was made again."""
        for place in list(self._places.values()):
            place.known, place.is_overtaken = None, True
            self._advance(place, now)

    def receive_news(self, key: str, data: bytes, now: float) -> None:
        """Take the data that was just written to a key."""
        if key.startswith("relay."):
            beat, relay = self._decode(Beat, data), key.removeprefix("relay.")
            if beat is not None and beat.relay == relay:
                self._hear(beat, now)
            elif not data and relay != self._me:  # it has stopped
                self._relays.pop(relay, None)
            return
        claim, place = self._decode(Claim, data), self._places.get(key)
        is_mine = claim is not None and claim.relay == self._me
        if place is None:
            if not is_mine:
                return
            place = self._places[key] = _Place(key, reserved_until_s=now + RESERVED_S)
        elif is_mine or (place.request is not None and place.request.data == data):
            return
        place.known, place.is_overtaken = None, True
        self._advance(place, now)

    def receive_answer(self, key: str, found: tuple[bytes, int] | None, now: float) -> None:
        """Take the answer to a request.

        Args:
            key: The key of the request.
            found: The data of the key now and its revision; None if they are not known.
        """
        place = self._places[key]
        request, place.request, place.known = place.request, None, None
        assert request is not None
        if found is None:
            place.retry_s = now + RETRY_S
        elif not place.is_overtaken:
            claim = self._decode(Claim, found[0])
            place.known = claim, found[1]
            if claim is not None:  # a relay that was never heard is dead some time from now
                unknown = Beat(claim.relay, "", 0, is_open=False)
                self._relays.setdefault(claim.relay, _Relay(unknown, now - LATE_S))
            if request.data or not place.written_s:
                place.written_s = now
            self._counts["claimed"] += bool(request.data)
        self._advance(place, now)

    def tick(self, now: float) -> None:
        """Do what is due; called every quarter of a second, or later if this relay stood still."""
        if self._ticked_s is not None and (gap_s := now - self._ticked_s) > _GAP_S:
            for relay in self._relays.values():
                relay.heard_s += gap_s
        self._ticked_s = now
        forgotten = [name for name, r in self._relays.items() if now - r.heard_s > REWRITE_S]
        for name in set(forgotten) - {self._me}:
            del self._relays[name]
        for place in list(self._places.values()):
            self._advance(place, now)

    def take_events(self) -> list[Placed]:
        """Take the decisions made since the last call, in order."""
        events, self._events = self._events, []
        return events

    def _advance(self, place: _Place, now: float) -> None:
        """Do what the table of this module says."""
        is_here = place.room in self._rooms
        if not self.is_up:
            if place.has_joins:
                self._counts["local"] += 1
                self._let_in(place, now)
            elif place.leaves_to and is_here:
                self._send_to(place, "")
        if place.request is not None:
            return
        claim, _ = place.known or (None, 0)
        is_mine = claim is not None and claim.relay == self._me
        if not (is_here or place.has_joins or is_mine or now < place.reserved_until_s):
            del self._places[place.key]
            return
        if not self.is_up or now < place.retry_s:
            return
        if place.known is None:
            self._request(place, None)
        elif claim is None:
            self._claim(place, is_here=is_here, now=now)
        elif is_mine:
            self._hold(place, claim, is_here=is_here, now=now)
        else:
            self._follow(place, claim, is_here=is_here, now=now)

    def _claim(self, place: _Place, *, is_here: bool, now: float) -> None:
        """Claim a room that no relay has, here or where the fewest connections are."""
        if is_here and place.own is not None:
            self._request(place, place.own)
        elif place.has_joins:
            target = self._choose(self._relays, now) or self._relays[self._me]
            target.placed_s.append(now)
            self._request(place, self._new_claim(target.beat.relay, 0))

    def _hold(self, place: _Place, claim: Claim, *, is_here: bool, now: float) -> None:
        """Keep a room that this relay has, hand it over, or give it up."""
        if place.has_joins:
            self._let_in(place, now)
        elif not is_here:
            if now >= place.reserved_until_s:
                self._request(place, b"")
        elif place.leaves_to:
            self._counts["handed_over"] += 1
            self._request(place, self._new_claim(place.leaves_to, claim.term + 1))
        else:
            place.own = claim
            if now - place.written_s >= REWRITE_S:
                self._request(place, claim)

    def _follow(self, place: _Place, claim: Claim, *, is_here: bool, now: float) -> None:
        """Follow the claim of another relay, or contest it."""
        relay = self._relays.get(claim.relay)  # None: it has stopped
        silent_s = LEASE_S if relay is None else now - relay.heard_s
        if not (is_here or place.has_joins):
            return
        if silent_s >= LEASE_S:
            self._counts["taken_over"] += 1
            self._request(place, self._new_claim(self._me, claim.term + 1))
        elif is_here and place.own is not None and place.own.rank < claim.rank:
            self._counts["contested"] += 1
            self._request(place, place.own)
        elif relay is not None and silent_s < LATE_S:
            self._send_to(place, relay.beat.url)

    def _choose(self, names: Iterable[str], now: float) -> _Relay | None:
        """Return the live relay with the fewest connections that takes rooms, or None."""
        relays = [self._relays[name] for name in sorted(names, key=lambda n: (n != self._me, n))]
        takers = [r for r in relays if r.beat.is_open and now - r.heard_s < LATE_S]
        return min(takers, key=lambda relay: relay.load(now), default=None)

    def _let_in(self, place: _Place, now: float) -> None:
        place.has_joins, place.reserved_until_s = False, now + RESERVED_S
        self._events.append(Placed(place.room, None))

    def _send_to(self, place: _Place, url: str) -> None:
        self._counts["redirected"] += 1
        place.has_joins, place.leaves_to = False, ""
        self._events.append(Placed(place.room, url))

    def _place(self, room: str) -> _Place:
        key = room_key(room)
        place = self._places.setdefault(key, _Place(key))
        place.room = room
        return place

    def _new_claim(self, relay: str, term: int) -> Claim:
        return Claim(relay, term, round(self._unix_time() * 1000))

    def _request(self, place: _Place, what: Claim | bytes | None) -> None:
        """Request to write a claim, to remove the key (empty) or to read it (None)."""
        data = _encode(what) if isinstance(what, Claim) else what
        place.request = Request(place.key, data, place.known[1] if place.known else 0)
        place.is_overtaken = False
        self._make_request(place.request)

    def _decode(self, kind: type[_Record], data: bytes) -> _Record | None:
        """Decode a beat or a claim; None if there is none, or it is malformed."""
        if not data:
            return None
        try:
            record = kind(**json.loads(data))
            check_url("url", getattr(record, "url", ""))
            if all(type(getattr(record, each.name)) is each.type for each in fields(kind)):
                return record
        except (ValueError, TypeError):
            pass
        self._counts["unreadable"] += 1
        return None


def _encode(item: Beat | Claim) -> bytes:
    return json.dumps(asdict(item)).encode()
