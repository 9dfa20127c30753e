"""Which relay has a room, by what a bucket that all relays share says of it. Pure.

A room lives on one relay. The bucket has one key for each relay, its beat, renewed every `BEAT_S`,
and one for each room, the claim of the relay that has it. A claim holds for as long as its relay
beats; a relay that has not been heard for `LEASE_S` is dead. A key is written only over the
revision that was read, so of several relays that write at once one succeeds, and the others read
again and follow it.

    the bucket says   people are here                  joins wait                   neither
    this relay        stay, or hand over               let them in                  remove
    another, alive    the better claim wins            redirect                     forget
    another, late     stay                             wait                         forget
    another, dead     take it over                     take it over                 forget
    nobody            claim it                         claim it for the relay of    forget
                                                       the fewest connections
    no answer         stay                             let them in                  forget

The better claim is the one of the higher term; of the same term the older one. A relay that takes a
room over, or hands it over, raises the term: who was cut off for a while thereby gives way.
"""

import hashlib
import json
from collections.abc import Callable, Container, Iterable
from dataclasses import asdict, dataclass, fields
from typing import Final, NamedTuple, TypeVar

from pica_protocol.limits import check_url
from pica_server.ops.stats import RelayStats

BEAT_S: Final = 0.4
"""Between two beats of a relay (chosen: ten relays cost NATS 25 small writes a second)."""
LATE_S: Final = 0.7
"""A relay that has missed a beat is late: joins for its rooms wait until it is heard, or dead."""
LEASE_S: Final = 2.0
"""A relay that has not been heard for so long is dead (chosen: its people are to be back in their
rooms within five seconds)."""
RESERVED_S: Final = 10.0
"""So long a room waits for the first of those who were sent to this relay (chosen)."""
REWRITE_S: Final = 200.0
"""A claim is written again after that; the bucket drops what is three times as old."""
RETRY_S: Final = 0.1
"""From a request that did not succeed until the key is read again."""
_GAP_S: Final = 1.0
"""Time without a tick in which this relay stood still, and could not hear the others."""


@dataclass(frozen=True, slots=True)
class Beat:
    """What a relay says of itself."""

    relay: str
    url: str
    """Where clients reach it."""
    num_connections: int
    is_open: bool
    """Whether it takes new rooms."""


@dataclass(frozen=True, slots=True)
class Claim:
    """Which relay has a room."""

    relay: str
    term: int
    """How often the room was taken over or handed over."""
    since_ms: int
    """When it began, milliseconds since 1970."""

    @property
    def rank(self) -> tuple[int, int, str]:
        """Of two claims for one room the lower one holds."""
        return -self.term, self.since_ms, self.relay


class Request(NamedTuple):
    """Wants to know what the bucket says of a key, or to write it over a revision."""

    key: str
    data: bytes | None = None
    """None reads, and nothing removes the key."""
    revision: int = 0


class Placed(NamedTuple):
    """A relay is found: who waits for the room is let in, or redirected with all who are in it."""

    room: str
    url: str | None
    """The other relay, "" if it has no address; None: it is this one."""


_Record = TypeVar("_Record", Beat, Claim)


@dataclass(slots=True)
class _Relay:
    beat: Beat
    heard_s: float
    num_placed: int = 0
    """Rooms that this relay has claimed for it since."""


@dataclass(slots=True)
class _Place:
    """One room: what is known and wanted of it."""

    key: str
    room: str = ""
    has_joins: bool = False
    """Joins wait for it."""
    own: Claim | None = None
    """Our claim while its people are here."""
    known: tuple[Claim | None, int] | None = None
    """What the bucket says, and its revision; None: it must be read."""
    first_known_s: float | None = None
    reserved_until_s: float = 0.0
    written_s: float = 0.0
    retry_s: float = 0.0
    request: Request | None = None
    """Under way."""
    is_overtaken: bool = False
    """The bucket has said something else since the request was made."""
    leaves_to: str = ""
    """The relay that gets it."""


def room_key(room: str) -> str:
    """Return the key of a room; names of rooms stand in no subject."""
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
            me: The id of this relay, different for each run.
            rooms: The rooms with people on this relay, as they are now.
            unix_time: The clock for claims, seconds since 1970.
            request: Makes a request later; each gets one answer.
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

    def note_started(self, room: str) -> None:
        """Note that the first of its people is in a room here."""
        place = self._place(room)
        known = place.known[0] if place.known is not None else None
        is_mine = known is not None and known.relay == self._me
        place.own = known if is_mine else self._new_claim(self._me, 0)

    def note_ended(self, room: str, now: float) -> None:
        """Note that nobody is in a room any more."""
        place = self._places.get(room_key(room))
        if place is not None:
            place.own, place.leaves_to, place.reserved_until_s = None, "", 0.0
            self._advance(place, now)

    def hand_over(self, room: str, now: float) -> bool:
        """Give a room to another relay; ``Placed`` follows. False if there is none."""
        place = self._places.get(room_key(room))
        target = self._choose(self._relays.keys() - {self._me}, now)
        if place is None or target is None or not self.is_up:
            return False
        place.leaves_to = target.beat.relay
        self._advance(place, now)
        return True

    def beat(self, url: str, num_connections: int, *, is_open: bool, now: float) -> bytes:
        """Return what this relay says of itself now."""
        beat = Beat(self._me, url, num_connections, is_open)
        self._relays[self._me] = _Relay(beat, now)
        return _encode(beat)

    def receive_renewed(self, now: float) -> None:
        """Note that the bucket has taken a beat; if it was away, all is read again."""
        if not self.is_up:
            self.is_up = True
            for relay in self._relays.values():
                relay.heard_s = now
            self.doubt_all(now)

    def receive_away(self, now: float) -> None:
        """Note that the bucket does not answer: rooms go on, new ones are made here."""
        self._counts["away"] += self.is_up
        self.is_up = False
        for place in list(self._places.values()):
            self._advance(place, now)

    def doubt_all(self, now: float) -> None:
        """Read everything again: news may have been lost, or the bucket was made anew."""
        for place in list(self._places.values()):
            place.known, place.is_overtaken = None, True
            self._advance(place, now)

    def receive_news(self, key: str, data: bytes, now: float) -> None:
        """Take what has just been written to a key."""
        if key.startswith("relay."):
            beat, relay = self._decode(Beat, data), key.removeprefix("relay.")
            if beat is not None:
                self._relays[relay] = _Relay(beat, now)
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
            key: Of the request.
            found: What the bucket says now, and its revision; None if that is not known.
        """
        place = self._places[key]
        request, place.request, place.known = place.request, None, None
        assert request is not None
        if found is None:
            place.retry_s = now + RETRY_S
        elif not place.is_overtaken:
            place.known = self._decode(Claim, found[0]), found[1]
            if request.data or place.first_known_s is None:
                place.written_s = now
            if place.first_known_s is None:
                place.first_known_s = now
            self._counts["claimed"] += bool(request.data)
        self._advance(place, now)

    def tick(self, now: float) -> None:
        """Do what has become due; called every quarter of a second, or later if this relay stood
        still."""
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
        """Take what has come out, in order."""
        events, self._events = self._events, []
        return events

    def _advance(self, place: _Place, now: float) -> None:
        """Do what the table says."""
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
        """Claim a room that no relay has."""
        if is_here and place.own is not None:
            self._request(place, place.own)
        elif place.has_joins:
            target = self._choose(self._relays, now) or self._relays[self._me]
            target.num_placed += 1
            self._request(place, self._new_claim(target.beat.relay, 0))

    def _hold(self, place: _Place, claim: Claim, *, is_here: bool, now: float) -> None:
        """Keep a room that this relay has, or let it go."""
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
        relay = self._relays.get(claim.relay)
        heard_s = place.first_known_s if relay is None else relay.heard_s
        silent_s = 0.0 if heard_s is None else now - heard_s
        if not (is_here or place.has_joins):
            return
        if silent_s >= LEASE_S:
            self._counts["taken_over"] += 1
            self._request(place, self._new_claim(self._me, claim.term + 1))
        elif is_here and place.own is not None and place.own.rank < claim.rank:
            self._counts["contested"] += 1
            self._request(place, place.own)
        elif silent_s < LATE_S and relay is not None:
            self._send_to(place, relay.beat.url)

    def _choose(self, names: Iterable[str], now: float) -> _Relay | None:
        """Return the live relay with the fewest connections that takes rooms, or None."""
        relays = [self._relays[name] for name in sorted(names, key=lambda n: (n != self._me, n))]
        takers = [r for r in relays if r.beat.is_open and now - r.heard_s < LATE_S]
        return min(takers, key=lambda r: r.beat.num_connections + r.num_placed, default=None)

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
        """Have a claim written, the key removed (empty), or read (None)."""
        data = _encode(what) if isinstance(what, Claim) else what
        place.request = Request(place.key, data, place.known[1] if place.known else 0)
        place.is_overtaken = False
        self._make_request(place.request)

    def _decode(self, kind: type[_Record], data: bytes) -> _Record | None:
        """Read a beat or a claim; what cannot be read is none."""
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
