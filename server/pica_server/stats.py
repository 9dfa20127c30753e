"""Counters of a relay and the percentiles of its forwarding latency. Pure: times are arguments."""

import math
from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass, field, fields
from typing import Any

_BUCKETS_PER_OCTAVE = 8
_SMALLEST_S = 1e-6
_NUM_BUCKETS = 27 * _BUCKETS_PER_OCTAVE  # up to 134 s
_BOUNDS_S = [_SMALLEST_S * 2 ** (bucket / _BUCKETS_PER_OCTAVE) for bucket in range(1, _NUM_BUCKETS)]
"""Between the buckets. To look a latency up takes a third of the time of a logarithm."""


class LatencyHistogram:
    """Latencies in buckets a twelfth wide: bounded memory, percentiles within 5 % of the value."""

    def __init__(self) -> None:
        self.count = 0
        self.sum_s = 0.0
        self._buckets = [0] * _NUM_BUCKETS

    def record(self, latency_s: float, times: int = 1) -> None:
        """Count a latency so many times; one outside 1 µs to 134 s goes to the nearest bucket."""
        self._buckets[bisect_right(_BOUNDS_S, latency_s)] += times
        self.count += times
        self.sum_s += latency_s * times

    def count_within(self, bound_s: float) -> int:
        """Return how many were at most ``bound_s``, to the width of a bucket."""
        num_buckets = math.floor(math.log2(bound_s / _SMALLEST_S) * _BUCKETS_PER_OCTAVE + 0.5)
        return sum(self._buckets[: max(num_buckets, 0)])

    def percentile_s(self, percent: float) -> float | None:
        """Return the middle of the bucket where the percentile lies; None without any latency."""
        rank = max(1, math.ceil(self.count * percent / 100))
        seen = 0
        for bucket, count in enumerate(self._buckets):
            seen += count
            if seen >= rank:
                return float(_SMALLEST_S * 2 ** ((bucket + 0.5) / _BUCKETS_PER_OCTAVE))
        return None


@dataclass(slots=True)
class RelayStats:
    """What a relay has done since it started."""

    connections: int = 0
    """Number of websockets opened."""
    joins: int = 0
    """Peers let into a room."""
    frames_in: int = 0
    bytes_in: int = 0
    """Bytes of all messages received, as websocket payload."""
    frames_out: int = 0
    bytes_out: int = 0
    """Bytes of all messages sent; of media with the header of the websocket message."""
    messages_out: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    """Frames that a receiver did not get. As it reads slowly: ``replaced`` by a newer one; of
    ordered streams ``expired`` at the deadline, ``overflow``, too many wait. As the relay has too
    much to do: ``late``. Besides: ``departed`` with either end; ``muted``."""
    resumes: Counter[str] = field(default_factory=Counter)
    """Peers who lost their connection and may come back: ``away``. Those who tried: ``resumed``;
    ``unknown``, the place was not there (any more); ``unfit``, as another peer."""
    whispers: int = 0
    """Private messages (``Whisper``) passed on."""
    whispers_dropped: Counter[str] = field(default_factory=Counter)
    """Private messages that were not: the sender's ``rate`` was too high, or the receiver is not
    in the room (``absent``). A whisper that a slow receiver does not get counts as a frame."""
    limits_hit: Counter[str] = field(default_factory=Counter)
    """How often a limit was reached: ``bytes`` or ``metadata`` updates of a client,
    ``joins``, ``connections`` in all, ``address``, ``room``, ``control`` left unread; ``late``,
    joins while the relay has too much to do; ``admission``, a join that its token did not allow;
    ``sockets`` that were cut at once, a ``request`` that grew too long before it was a websocket;
    ``extra_frames``, pings and fragments."""
    closed: Counter[int] = field(default_factory=Counter)
    """Connections ended, by close code; 0 is any code that is not ours."""
    store: Counter[str] = field(default_factory=Counter)
    """What the avatar store did: ``downloads`` begun, ``downloads_cut``, ``downloads_refused`` as
    there were too many, ``download_bytes``; ``uploads_done``, of which ``uploads_known`` were there
    already and ``uploads_kept`` are new, ``uploads_refused``, ``uploads_cut`` by their sender,
    ``upload_bytes``; ``faults`` of its place."""
    log: Counter[str] = field(default_factory=Counter)
    """Lines of the log that were ``taken`` to be written; ``dropped``, as too many waited because
    they are not read."""
    placement: Counter[str] = field(default_factory=Counter)
    """Rooms: ``claimed`` for this relay or another; ``redirected`` to the relay that has them;
    ``taken_over`` from a dead relay; ``handed_over`` by a drain; ``local``, made here while NATS
    was ``away``."""
    forwarding: LatencyHistogram = field(default_factory=LatencyHistogram)
    """Latencies from a frame's receipt to the moment the receiver's socket took it."""

    def note_sent(
        self, num_messages: int, num_bytes: int, num_frames: int, latency_s: float
    ) -> None:
        """Count messages that went out together; ``latency_s`` is that of their oldest frame."""
        self.messages_out += num_messages
        self.bytes_out += num_bytes
        self.frames_out += num_frames
        if num_frames:
            self.forwarding.record(latency_s, num_frames)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain values; latencies in milliseconds."""
        counters = {
            each.name: _plain(getattr(self, each.name))
            for each in fields(self)
            if each.name != "forwarding"
        }
        percentiles = {f"p{p}": self.forwarding.percentile_s(p) for p in (50, 95, 99)}
        forward_ms = {p: s if s is None else round(s * 1000, 4) for p, s in percentiles.items()}
        return {**counters, "forward_ms": forward_ms}


def _plain(count: "int | Counter[Any]") -> int | dict[str, int]:
    if isinstance(count, int):
        return count
    return {str(key): count[key] for key in sorted(count, key=str)}
