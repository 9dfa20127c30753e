"""The relay's numbers as Prometheus reads them (text format 0.0.4). Pure.

Written here and not with a client library: it is one page of text made of counters that exist
anyway, and the relay stays without another dependency and without global state. No room, name or
address appears in it.
"""

from collections.abc import Iterable, Mapping
from typing import Final

from pica_server.ops.stats import LatencyHistogram, RelayStats

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"

BOUNDS_S: Final = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Upper bounds of the forwarding latency's buckets; what is asked for is 10 ms."""

_Labelled = Mapping[tuple[tuple[str, str], ...], float]


def metrics_text(stats: RelayStats, gauges: Mapping[str, tuple[str, float]]) -> str:
    """Return the page.

    Args:
        stats: The counters.
        gauges: What is so now: name without prefix to explanation and value.
    """
    lines: list[str] = []
    for name, (text, value) in gauges.items():
        lines += _family(name, "gauge", text, {(): value})
    for name, text, value in (
        ("connections_total", "Websockets opened.", stats.connections),
        ("joins_total", "Peers let into a room.", stats.joins),
        ("bytes_in_total", "Payload bytes of all messages received.", stats.bytes_in),
        ("bytes_out_total", "Payload bytes of all messages sent.", stats.bytes_out),
        ("messages_out_total", "Messages sent.", stats.messages_out),
        ("frames_out_total", "Frames sent, counted for each receiver.", stats.frames_out),
        ("frames_unwanted_total", "Frames a receiver had asked not to get.", stats.unwanted),
        ("frames_resumed_total", "Kept frames sent to latecomers.", stats.frames_resumed),
        ("whispers_total", "Whispers passed on.", stats.whispers),
        ("reported_lost_total", "Frames receivers reported missing.", stats.reported_lost),
        (
            "reported_concealed_total",
            "Display times receivers reported without a fresh frame.",
            stats.reported_concealed,
        ),
    ):
        lines += _family(name, "counter", text, {(): value})
    for name, text, label, values in (
        ("frames_in_total", "Frames received.", "layer", stats.frames_in_by_layer),
        ("frames_dropped_total", "Frames a receiver did not get.", "reason", stats.dropped),
        ("keyframe_requests_total", "Keyframe requests.", "reason", stats.keyframe_requests),
        ("whispers_dropped_total", "Whispers not passed on.", "reason", stats.whispers_dropped),
        ("cluster_total", "What happened in the cluster.", "event", stats.cluster),
        (
            "cluster_frames_dropped_total",
            "Frames another node did not get.",
            "reason",
            stats.cluster_dropped,
        ),
        ("resumes_total", "Lost connections, and who came back.", "outcome", stats.resumes),
        ("webhooks_total", "Events for the webhook.", "outcome", stats.webhooks),
        ("limits_hit_total", "How often a limit was reached.", "limit", stats.limits_hit),
        ("store_total", "What the avatar store did, times or bytes.", "what", stats.store),
        ("closed_total", "Connections ended.", "code", stats.closed),
    ):
        labelled: _Labelled = {
            ((label, str(key)),): count
            for key, count in sorted(values.items(), key=lambda item: str(item[0]))
        }
        lines += _family(name, "counter", text, labelled)
    lines += _histogram(
        "forward_seconds",
        "From a frame's receipt to the moment the receiver's socket took it.",
        stats.forwarding,
    )
    return "\n".join(lines) + "\n"


def _family(name: str, kind: str, text: str, values: _Labelled) -> Iterable[str]:
    yield f"# HELP pica_{name} {text}"
    yield f"# TYPE pica_{name} {kind}"
    for labels, value in values.items():
        inner = ",".join(f'{key}="{label}"' for key, label in labels)
        yield f"pica_{name}{{{inner}}} {value!r}" if inner else f"pica_{name} {value!r}"


def _histogram(name: str, text: str, latencies: LatencyHistogram) -> Iterable[str]:
    yield f"# HELP pica_{name} {text}"
    yield f"# TYPE pica_{name} histogram"
    for bound_s in BOUNDS_S:
        yield f'pica_{name}_bucket{{le="{bound_s:g}"}} {latencies.count_within(bound_s)}'
    yield f'pica_{name}_bucket{{le="+Inf"}} {latencies.count}'
    yield f"pica_{name}_sum {latencies.sum_s:.6f}"
    yield f"pica_{name}_count {latencies.count}"
