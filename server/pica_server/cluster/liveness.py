"""Which nodes live, and whether this one is part of the cluster. Pure.

A node renews its lease every ``BEAT_S`` in the key-value store; all nodes hear of it. A node that
was not heard for ``LEASE_S`` is dead to the others: its peers are gone and their places free. A
node whose renewal was not confirmed stops being part of the cluster sooner, after ``FENCE_S``, so
that it never counts on places that others have given away.

    standing    last confirmed renewal     joins                       peers of other nodes
    CLUSTERED   was sent < SUSPECT_S ago   agreed on by all nodes      shown
    UNCERTAIN   < FENCE_S ago              wait                        shown
    LOCAL       longer ago                 decided here, by who is     gone
                                           here

Who comes back from LOCAL has no opinion on others before it has listened for ``LEASE_S`` again.
"""

from enum import Enum
from typing import Final

BEAT_S: Final = 0.75
"""Between two renewals (chosen: four in a lease)."""
SUSPECT_S: Final = 1.75
"""Seconds from the last renewal that was confirmed: two have failed, something may be wrong."""
FENCE_S: Final = 2.25
"""From the last renewal that was confirmed, by the time it was sent, to the end of this node's
part in the cluster."""
LEASE_S: Final = 3.0
"""Seconds from the last renewal that was heard to the end of the node's peers for the others."""


class Standing(Enum):
    """What this node is to the cluster."""

    CLUSTERED = "clustered"
    UNCERTAIN = "uncertain"
    LOCAL = "local"


class Liveness:
    """What is known of the nodes, this one included."""

    def __init__(self, now: float) -> None:
        """Begin with a lease that was confirmed just now, knowing nobody."""
        self._renewed_s = now
        self._is_doubted = False
        self._listening_since_s = now
        self._heard_s: dict[str, float] = {}  # bounded: who is not heard of is forgotten

    def receive_renewed(self, sent_s: float, now: float) -> None:
        """Note that the lease was confirmed by an answer to what was sent then."""
        if self.standing(now) is not Standing.CLUSTERED:
            self._listening_since_s = now
        self._renewed_s = max(self._renewed_s, sent_s)
        self._is_doubted = False

    def doubt(self) -> None:
        """Note that the store may have been lost: joins wait for the next confirmed renewal."""
        self._is_doubted = True

    def receive_beat(self, node: str, now: float) -> None:
        """Note that a node renewed its lease."""
        self._heard_s[node] = now

    def forget(self, node: str) -> None:
        """Note that a node gave up its lease: it left in good order."""
        self._heard_s[node] = float("-inf")

    def standing(self, now: float) -> Standing:
        """Say what this node is now."""
        age_s = now - self._renewed_s
        if age_s < SUSPECT_S and not self._is_doubted:
            return Standing.CLUSTERED
        return Standing.UNCERTAIN if age_s < FENCE_S else Standing.LOCAL

    def was_heard_since(self, node: str, then: float) -> bool:
        """Say whether a node has renewed its lease since then."""
        return self._heard_s.get(node, float("-inf")) >= then

    def is_expired(self, node: str, now: float) -> bool:
        """Say whether a node is dead."""
        if self._heard_s.get(node) == float("-inf"):
            return True
        last_s = max(self._heard_s.get(node, 0.0), self._listening_since_s)
        return now - last_s > LEASE_S

    def alive(self, now: float) -> list[str]:
        """Return the other nodes that were heard within the lease; forget those long gone."""
        for node in [n for n, at in self._heard_s.items() if now - at > 100 * LEASE_S]:
            del self._heard_s[node]
        return [node for node, at in self._heard_s.items() if now - at <= LEASE_S]
