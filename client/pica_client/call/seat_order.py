"""Who sits on which chair: the order of the people on the picture. Pure.

A chair belongs to a person, not to a connection. When the relay restarts, everybody comes back with
another peer id and in another order; who comes back under the same name, with the same avatar if
there are several, finds their chair kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from pica_client.call.faces import FaceState

KEPT_S = 120.0
"""How long an empty chair is kept (chosen: a relay restarts, a laptop changes networks)."""
MAX_EMPTY = 64
"""Empty chairs that are kept; drops those on the left."""


@dataclass(slots=True, eq=False)
class _Chair:
    peer_id: str
    name: str
    avatar_id: str
    left_s: float | None = None
    """Since when nobody sits on it; None while somebody does."""
    before: str = ""
    """Its peer id in the frame before, if that was another."""


class SeatOrder:
    """Remembers the chairs of a call, from left to right."""

    def __init__(self) -> None:
        self._chairs: list[_Chair] = []
        self._num_lost = 0

    def arrange(self, faces: Sequence[FaceState], now: float) -> list[FaceState]:
        """The same people in the order of their chairs; newcomers sit at the end."""
        present = {face.peer_id: face for face in faces}
        for chair in self._chairs:
            chair.before = ""
            face = present.get(chair.peer_id)
            if face is not None and face.name != chair.name:
                # A relay that has started again deals the same ids to others.
                self._num_lost += 1
                chair.before, chair.peer_id, face = chair.peer_id, f"lost {self._num_lost}", None
            if face is not None:
                chair.left_s = None
            elif chair.left_s is None:
                chair.left_s = now
        taken = {chair.peer_id for chair in self._chairs}
        for face in faces:
            if face.peer_id not in taken:
                self._sit_down(face)
        empty = [(now - each.left_s, each) for each in self._chairs if each.left_s is not None]
        kept = [chair for away_s, chair in empty if away_s <= KEPT_S][-MAX_EMPTY:]
        self._chairs = [each for each in self._chairs if each.left_s is None or each in kept]
        return [present[chair.peer_id] for chair in self._chairs if chair.left_s is None]

    def follow(self, peer_id: str) -> str | None:
        """Who has, or had last, the chair that somebody sat on in the frame before; None if it is
        not kept any more."""
        by_before = {chair.before: chair.peer_id for chair in self._chairs}
        known = {chair.peer_id for chair in self._chairs}
        return by_before.get(peer_id, peer_id if peer_id in known else None)

    def _sit_down(self, face: FaceState) -> None:
        own = [each for each in self._chairs if each.left_s is not None and each.name == face.name]
        if not own:
            self._chairs.append(_Chair(face.peer_id, face.name, face.avatar_id))
            return
        chair = next((each for each in own if each.avatar_id == face.avatar_id), own[0])
        chair.before, chair.peer_id = chair.peer_id, face.peer_id
        chair.avatar_id, chair.left_s = face.avatar_id, None
