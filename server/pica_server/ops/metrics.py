"""The relay's numbers as Prometheus reads them. Pure; no room, name or address is among them.

The counters are `RelayStats`; prometheus-client only writes them, through a registry made for each
page, so there is no global state.
"""

from collections.abc import Iterator, Mapping
from typing import Final

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from pica_server.stats import RelayStats

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"

BOUNDS_S: Final = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Upper bounds of the forwarding latency's buckets; what is asked for is 10 ms."""

_COUNTERS: Final = (
    ("connections", "connections", "Websockets opened."),
    ("joins", "joins", "Peers let into a room."),
    ("bytes_in", "bytes_in", "Payload bytes of all messages received."),
    ("bytes_out", "bytes_out", "Payload bytes of all messages sent."),
    ("messages_out", "messages_out", "Messages sent."),
    ("frames_in", "frames_in", "Frames received."),
    ("frames_out", "frames_out", "Frames sent, counted for each receiver."),
    ("whispers", "whispers", "Private messages passed on."),
)
"""Name, field of `RelayStats`, explanation."""

_LABELLED_COUNTERS: Final = (
    ("frames_dropped", "dropped", "reason", "Frames a receiver did not get."),
    ("whispers_dropped", "whispers_dropped", "reason", "Private messages not passed on."),
    ("placement", "placement", "event", "What happened to rooms among several relays."),
    ("resumes", "resumes", "outcome", "Lost connections, and who came back."),
    ("limits_hit", "limits_hit", "limit", "How often a limit was reached."),
    ("store", "store", "what", "What the avatar store did, times or bytes."),
    ("log_lines", "log", "outcome", "Lines of the log."),
    ("closed", "closed", "code", "Connections ended."),
)
"""Name, field of `RelayStats`, label, explanation."""


def metrics_text(stats: RelayStats, gauges: Mapping[str, tuple[str, float]]) -> str:
    """Return the page; ``gauges`` are so now: name without prefix to explanation and value."""
    registry = CollectorRegistry()
    registry.register(_Page(stats, gauges))
    return generate_latest(registry).decode()


class _Page(Collector):
    def __init__(self, stats: RelayStats, gauges: Mapping[str, tuple[str, float]]) -> None:
        self._stats = stats
        self._gauges = gauges

    def collect(self) -> Iterator[Metric]:
        """Return the counters and what is so now."""
        for name, (text, value) in self._gauges.items():
            yield GaugeMetricFamily(f"pica_{name}", text, value)
        for name, field, text in _COUNTERS:
            yield CounterMetricFamily(f"pica_{name}", text, getattr(self._stats, field))
        for name, field, label, text in _LABELLED_COUNTERS:
            counter = CounterMetricFamily(f"pica_{name}", text, labels=[label])
            counts = getattr(self._stats, field)
            for key in sorted(counts, key=str):
                counter.add_metric([str(key)], counts[key])
            yield counter
        latencies = self._stats.forwarding
        buckets = [(f"{bound_s:g}", latencies.count_within(bound_s)) for bound_s in BOUNDS_S]
        yield HistogramMetricFamily(
            "pica_forward_seconds",
            "From a frame's receipt to the moment the receiver's socket took it.",
            buckets=[*buckets, ("+Inf", latencies.count)],
            sum_value=latencies.sum_s,
        )
