"""Counters of a relay and its forwarding latency, and how Prometheus reads them. Pure: times are
arguments; no room, name or address is among them.

prometheus-client only writes the page, through a registry made for each, so there is no global
state.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Final

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
BOUNDS_S: Final = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Upper bounds of the forwarding latency's buckets; what is asked for is 10 ms."""


class LatencyHistogram:
    """Latencies in the buckets of `BOUNDS_S`."""

    def __init__(self) -> None:
        self.count = 0
        self.sum_s = 0.0
        self.buckets = [0] * (len(BOUNDS_S) + 1)

    def record(self, latency_s: float, times: int = 1) -> None:
        """Count a latency so many times."""
        self.buckets[bisect_left(BOUNDS_S, latency_s)] += times
        self.count += times
        self.sum_s += latency_s * times


_LABELLED: Final = {
    "dropped": ("frames_dropped", "reason"),
    "whispers_dropped": ("whispers_dropped", "reason"),
    "placement": ("placement", "event"),
    "resumes": ("resumes", "outcome"),
    "limits_hit": ("limits_hit", "limit"),
    "store": ("store", "what"),
    "closed": ("closed", "code"),
}
"""Metric and label of the counters by a label; any other is called as its field."""


@dataclass(slots=True)
class RelayStats:
    """What a relay has done since it started."""

    connections: int = 0
    """Websockets opened."""
    joins: int = 0
    """Peers let into a room."""
    frames_in: int = 0
    """Frames received."""
    bytes_in: int = 0
    """Payload bytes of all messages received."""
    frames_out: int = 0
    """Frames sent, counted for each receiver."""
    bytes_out: int = 0
    """Bytes of all messages sent."""
    messages_out: int = 0
    """Messages sent."""
    dropped: Counter[str] = field(default_factory=Counter)
    """Frames a receiver did not get. As it reads slowly: ``replaced`` by a newer one; of ordered
    streams ``expired`` at the deadline, ``overflow``, too many wait. As the relay has too much to
    do: ``late``. Besides: ``departed`` with either end; ``muted``."""
    resumes: Counter[str] = field(default_factory=Counter)
    """Lost connections, and who came back. Peers who lost their connection and may come back:
    ``away``. Those who tried: ``resumed``; ``unknown``, the place was not there (any more);
    ``unfit``, as another peer."""
    whispers: int = 0
    """Private messages passed on."""
    whispers_dropped: Counter[str] = field(default_factory=Counter)
    """Private messages not passed on. The sender's ``rate`` was too high, or the receiver is not in
    the room (``absent``). One that a slow receiver does not get counts as a frame."""
    limits_hit: Counter[str] = field(default_factory=Counter)
    """How often a limit was reached. ``bytes`` or ``metadata`` updates of a client, ``joins``,
    ``connections`` in all, ``address``, ``room``, ``control`` left unread; ``late``, joins while
    the relay is overloaded; ``admission``, a join that its token did not allow; ``sockets`` that
    were cut at once, a ``request`` that grew too long before it was a websocket; ``extra_frames``,
    pings and fragments."""
    closed: Counter[int] = field(default_factory=Counter)
    """Connections ended. By close code; 0 is any code that is not ours."""
    store: Counter[str] = field(default_factory=Counter)
    """What the avatar store did, times or bytes. ``downloads`` begun, ``downloads_cut``,
    ``downloads_refused`` as there were too many, ``download_bytes``; ``uploads_done``, of which
    ``uploads_known`` were there already and ``uploads_kept`` are new, ``uploads_refused``,
    ``uploads_cut`` by their sender, ``upload_bytes``; ``faults`` of its place."""
    placement: Counter[str] = field(default_factory=Counter)
    """What happened to rooms among several relays. ``claimed`` for this relay or another;
    ``redirected`` to the relay that has them; ``taken_over`` from one that is dead or drains;
    ``local``, made here while NATS was ``away``."""
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

    def counters(self) -> "dict[str, int | Counter[Any]]":
        """Return all counters by name."""
        return {each.name: getattr(self, each.name) for each in fields(self)[:-1]}

    def as_dict(self) -> dict[str, Any]:
        """Return all counters as plain values."""
        counted: dict[str, Any] = dict(self.counters())
        for name in _LABELLED:
            counted[name] = {str(key): counted[name][key] for key in sorted(counted[name], key=str)}
        return counted


def metrics_text(stats: RelayStats, gauges: Mapping[str, float]) -> str:
    """Return the page; ``gauges`` are so now, by name without prefix."""
    registry = CollectorRegistry()
    registry.register(_Page(stats, gauges))
    return generate_latest(registry).decode()


class _Page(Collector):
    def __init__(self, stats: RelayStats, gauges: Mapping[str, float]) -> None:
        self._stats = stats
        self._gauges = gauges

    def collect(self) -> Iterator[Metric]:
        """Return the counters and what is so now."""
        for name, value in self._gauges.items():
            yield GaugeMetricFamily(f"pica_{name}", name, float(value))
        for name, count in self._stats.counters().items():
            if isinstance(count, int):
                yield CounterMetricFamily(f"pica_{name}", name, count)
                continue
            metric, label = _LABELLED[name]
            counter = CounterMetricFamily(f"pica_{metric}", metric, labels=[label])
            for key in sorted(count, key=str):
                counter.add_metric([str(key)], count[key])
            yield counter
        latencies, seen = self._stats.forwarding, 0
        buckets = []
        for bound_s, count in zip(BOUNDS_S, latencies.buckets, strict=False):
            seen += count
            buckets.append((f"{bound_s:g}", seen))
        yield HistogramMetricFamily(
            "pica_forward_seconds",
            "From a frame's receipt to the moment the receiver's socket took it.",
            buckets=[*buckets, ("+Inf", latencies.count)],
            sum_value=latencies.sum_s,
        )
