"""Rulings of an admin that outlast connections: who is kept out, whose tracks are stopped. Pure.

A ruling is about an identity in a room: all of it, or its tracks of one kind. It ends at a time of
its own, not with the room. Of two opinions on the same the newer counts, so a lifted ruling is kept
until it would have ended, and nodes of a cluster may put together what they know in any sequence.
"""

import hashlib
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

RULING_S: Final = 86_400.0
"""A ruling holds for a day, unless the admin says otherwise (chosen)."""
MAX_RULING_S: Final = 30 * 86_400.0
MAX_RULINGS: Final = 256
"""Rulings of one room; one more drops the oldest (chosen)."""
MAX_ROOMS: Final = 1024
"""Rooms with rulings; one more drops those of the room that has had none for longest (chosen)."""

BAR: Final = ""
"""Stands for all of an identity, where the kind of a track stands else."""

Subject = tuple[str, str]
"""What a ruling is about: what stands for an identity, and the kind of its tracks or ``BAR``."""


class Ruling(NamedTuple):
    """One opinion of an admin."""

    given_ms: int
    """When it was given, milliseconds since 1970."""
    ends_s: int
    """When it ends, seconds since 1970."""
    holds: bool
    """Whether it holds, and was not lifted."""


RoomRulings = Mapping[Subject, Ruling]


def identity_key(identity: str) -> str:
    """Return what stands for an identity in rulings: names of those who are gone are not kept."""
    return hashlib.sha256(b"pica identity\0" + identity.encode()).hexdigest()[:32]


class Rulings:
    """The rulings of all rooms that one relay knows of."""

    def __init__(self, unix_time: Callable[[], float]) -> None:
        """Begin without any; they end by the clock ``unix_time``, seconds since 1970."""
        self._unix_time = unix_time
        self._rooms: dict[str, dict[Subject, Ruling]] = {}

    def of(self, room: str) -> RoomRulings:
        """Return the rulings of a room, lifted ones too."""
        kept = self._rooms.get(room, {})
        now_s = self._unix_time()
        return {subject: ruling for subject, ruling in kept.items() if ruling.ends_s > now_s}

    def holds(self, room: str, identity: str, kind: str = BAR) -> bool:
        """Say whether an identity is barred, or its tracks of a kind are stopped."""
        ruling = self.of(room).get((identity_key(identity), kind)) if identity else None
        return ruling is not None and ruling.holds

    def give(
        self, room: str, identity: str, kind: str = BAR, *, holds: bool, lasts_s: float = RULING_S
    ) -> bool:
        """Rule something, or lift it; return whether it can be: it needs an identity."""
        if not identity:
            return False
        subject, now_s = (identity_key(identity), kind), self._unix_time()
        before = self.of(room).get(subject)
        if before is None and not holds:
            return True
        given_ms, ends_s = int(now_s * 1000), int(now_s + lasts_s)
        if before is not None:  # the clocks of two nodes may differ, and this is the newer opinion
            given_ms = max(given_ms, before.given_ms + 1)
            ends_s = ends_s if holds else before.ends_s
        self.learn(room, {subject: Ruling(given_ms, ends_s, holds)})
        return True

    def learn(self, room: str, rulings: RoomRulings) -> set[Subject]:
        """Take over what others know of a room; return what there is news of."""
        before = self.of(room)
        known = dict(before)
        for subject, ruling in rulings.items():
            known[subject] = max(ruling, known.get(subject, ruling))
        newest = sorted(known.items(), key=lambda item: (item[1], item[0]))[-MAX_RULINGS:]
        self._rooms.pop(room, None)
        if newest:
            self._rooms[room] = dict(newest)
            if len(self._rooms) > MAX_ROOMS:
                del self._rooms[next(iter(self._rooms))]
        return {subject for subject, _ in self.of(room).items() - before.items()}
