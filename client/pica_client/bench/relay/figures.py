"""What is made of a relay bench's counts: percentiles, sums, and a line to read."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from itertools import accumulate
from typing import Any

from pica_client.bench.relay.tally import STEP_US


def describe(row: dict[str, Any]) -> str:
    """One line about a measurement."""
    forward, cpu = row["forward_ms"], row["relay_cpu_ratio"]
    per_1000 = row["relay_cpu_s_per_1000"]
    return (
        f"{row['rooms']} rooms of {row['peers']} at {row['fps']:g} fps: "
        f"{row['delivered_per_s']:,.0f} frames/s delivered, forwarding p50 {forward['p50']} ms, "
        f"p99 {forward['p99']} ms, "
        + (f"voices p99 {row['voice_ms']['p99']} ms, " if row["voice_ms"] else "")
        + f"dropped {row['dropped']}, missing {row['missing']}"
        + ("" if cpu is None else f", core {cpu:.0%} busy, {per_1000} s per 1,000")
        + f"; generator {max(row['generator']['cpu_ratio']):.0%} busy"
    )


def is_within(
    forward_ms: dict[str, float | None], missing: int, expected: int, bar_ms: float
) -> bool:
    """Within the bar: late frames are few, and so are those that never came."""
    p99 = forward_ms["p99"]
    return p99 is not None and p99 <= bar_ms and missing <= expected * 0.001


def merged(answers: Sequence[dict[str, Any]], key: str) -> Counter[int]:
    """Put the histograms of all swarms together."""
    merged: Counter[int] = Counter()
    for answer in answers:
        merged.update({int(step): count for step, count in answer[key].items()})
    return merged


def percentiles(steps: Counter[int]) -> dict[str, float | None]:
    """Percentiles of a histogram of the swarms, upper edges, in milliseconds."""
    ordered = sorted(steps)
    seen = list(accumulate(steps[step] for step in ordered))
    found: dict[str, float | None] = {}
    for percent in (50, 95, 99):
        place = bisect_left(seen, seen[-1] * percent / 100) if seen else None
        found[f"p{percent}"] = (
            None if place is None else round((ordered[place] + 1) * STEP_US / 1e3, 3)
        )
    return found


def relay_percentiles(metrics: dict[str, float]) -> dict[str, float | None] | None:
    """Percentiles of the relay's histogram: the upper bounds of the buckets they lie in."""
    prefix = "pica_forward_seconds_bucket"
    buckets = [
        (float(name.partition('le="')[2].partition('"')[0].replace("+Inf", "inf")), count)
        for name, count in metrics.items()
        if name.startswith(prefix)
    ]
    if not buckets:
        return None
    buckets.sort()
    total = buckets[-1][1]
    return {
        f"p{percent}": next(
            (
                None if bound == float("inf") else round(bound * 1e3, 3)
                for bound, count in buckets
                if total and count >= total * percent / 100
            ),
            None,
        )
        for percent in (50, 95, 99)
    }


def close_codes(answers: Sequence[dict[str, Any]]) -> dict[str, int]:
    """Count with which codes the swarms' peers were closed."""
    codes: Counter[str] = Counter()
    for answer in answers:
        codes.update(answer["closed"])
    return dict(codes)
