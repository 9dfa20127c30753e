"""Who may come back to their place in a room, with which secret, and until when. Pure.

    place not kept       -- issue --> held -- go_away --> away -- redeem --> (issue again)
                                       |                   |
                                       +--- redeem,        +--- grace over: take_expired
                                            forget

A secret is good once. Only its hash is kept, so nothing that is looked at or printed here lets
anybody in; and since a guess has to find a preimage, comparing needs no constant time.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(slots=True)
class _Place:
    room: str
    digest: bytes
    away_until_s: float | None = None


class ResumeTickets:
    """The places of one relay that may be come back to; as many as there are peers."""

    def __init__(self, grace_s: float, new_secret: Callable[[], str]) -> None:
        """Begin empty; ``grace_s`` is how long a place is kept, 0: none ever is."""
        self.grace_s = grace_s
        self._new_secret = new_secret
        self._places: dict[str, _Place] = {}
        self._by_digest: dict[bytes, str] = {}
        # All are kept for the same time, so the order of going is the order of the deadlines.
        self._away: dict[str, None] = {}

    def issue(self, room: str, peer_id: str) -> str:
        """Return a new secret for a place, instead of the one before; empty if none is kept."""
        self.forget(peer_id)
        if self.grace_s <= 0:
            return ""
        secret = self._new_secret()
        digest = _digest(secret)
        self._places[peer_id] = _Place(room, digest)
        self._by_digest[digest] = peer_id
        return secret

    def place_of(self, room: str, secret: str) -> str | None:
        """Return whose place a secret opens, or None."""
        peer_id = self._by_digest.get(_digest(secret))
        return None if peer_id is None or self._places[peer_id].room != room else peer_id

    def redeem(self, room: str, secret: str) -> str | None:
        """Return whose place a secret opens, or None; it opens nothing any more."""
        peer_id = self.place_of(room, secret)
        if peer_id is not None:
            self.forget(peer_id)
        return peer_id

    def go_away(self, peer_id: str, now: float) -> bool:
        """Note that a peer lost its connection; return whether its place is kept."""
        place = self._places.get(peer_id)
        if place is None:
            return False
        place.away_until_s = now + self.grace_s
        self._away[peer_id] = None
        return True

    def forget(self, peer_id: str) -> None:
        """Note that a place is given up."""
        place = self._places.pop(peer_id, None)
        if place is not None:
            del self._by_digest[place.digest]
            self._away.pop(peer_id, None)

    def next_timer(self) -> float | None:
        """Return when the next place is given up, or None."""
        first = next(iter(self._away), None)
        return None if first is None else self._places[first].away_until_s

    def take_expired(self, now: float) -> list[str]:
        """Take the ids of those whose time is over."""
        expired = []
        while (due_s := self.next_timer()) is not None and due_s <= now:
            peer_id = next(iter(self._away))
            expired.append(peer_id)
            self.forget(peer_id)
        return expired


def _digest(secret: str) -> bytes:
    return hashlib.sha256(secret.encode()).digest()
