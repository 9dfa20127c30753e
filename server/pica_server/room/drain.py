"""When which room is sent away, so that the relay that takes them can let them in. Pure."""

from collections.abc import Sequence

TELLING_SHARE = 0.5
"""The share of a drain's time in which all are told; the rest is left for them to go (chosen)."""


def departures(
    sizes: Sequence[int], *, per_s: float, burst: float, longest_s: float
) -> list[float]:
    """Return when each room is told, in seconds from the beginning of the drain.

    A room goes together, so that its people do not lose sight of each other for longer than they
    must. Rooms follow each other as fast as a relay with our own limits lets peers join, or as fast
    as the time allows.

    Args:
        sizes: How many peers each room has.
        per_s: Joins a second that the other relay takes; ``burst`` are those that it takes at once.
        longest_s: How long the drain may take.
    """
    offsets_s = []
    gone = 0
    for size in sizes:
        gone += size
        offsets_s.append(max(gone - burst, 0.0) / per_s)
    latest_s = TELLING_SHARE * longest_s
    last_s = max(offsets_s, default=0.0)
    scale = latest_s / last_s if last_s > latest_s else 1.0
    return [offset_s * scale for offset_s in offsets_s]
