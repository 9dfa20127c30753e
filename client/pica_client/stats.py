"""Numbers about a call: percentiles of bounded samples, and the record of the machine."""

import math
import os
import platform
from collections.abc import Iterable

Summary = dict[str, float | None]

PERCENTILES = (50, 95, 99)
MAX_SAMPLES = 20_000
"""The latest samples of a call are kept: two minutes of five peers at 30 frames a second. A list of
them takes 0.6 MB; of five times as many, ten lists grew for eleven minutes."""
TCP_IP_HEADER_BYTES = 40
"""IPv4 and TCP without options, once a message."""


def wire_bytes(message_bytes: int, *, is_masked: bool) -> int:
    """What one websocket message costs on the network: with its frame header (RFC 6455 5.2; clients
    mask) and one TCP segment over IPv4, without acknowledgements, TLS and the link layer."""
    length_bytes = 2 if message_bytes < 126 else 4 if message_bytes < 65536 else 10
    return message_bytes + length_bytes + (4 if is_masked else 0) + TCP_IP_HEADER_BYTES


def percentile(ordered: list[float], percent: float) -> float:
    """The nearest-rank percentile, above 0 and at most 100, of at least one sample, ascending: it
    is always one of them."""
    return ordered[max(math.ceil(percent / 100 * len(ordered)), 1) - 1]


def summarise_ms(samples_s: Iterable[float]) -> Summary:
    """p50, p95 and p99 in milliseconds of samples in seconds; None where there are none."""
    ordered = sorted(samples_s)
    return {
        f"p{percent}": round(percentile(ordered, percent) * 1e3, 3) if ordered else None
        for percent in PERCENTILES
    }


def describe_machine() -> dict[str, object]:
    """What a number was measured on. No host name: results are published."""
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "cores": os.cpu_count(),
    }
