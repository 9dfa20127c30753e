"""Healthy rooms beside somebody who behaves badly: what changes for them, and what it gets.

For each kind of offender the same rooms are measured before it comes and while it is there. What it
was closed with is what the relay counts (an offender that does not read sees no code) and what it
saw itself.
"""

import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from malice import clients
from malice.clients import KINDS
from pica_client.bench.relay.bench import Load, RelayBenchConfig, Target, relay_target
from pica_client.bench.relay.figures import describe
from pica_client.bench.relay.processes import (
    START_TIMEOUT_S,
    Workers,
    memory_bytes,
    relay_metrics,
    share_cores,
)
from pica_client.errors import OptionError
from pica_client.local_call.processes import Children
from pica_client.stats import describe_machine

LIMIT_ARGUMENTS: Final = ("--limits.joins-per-s", "50", "--limits.joins-burst", "200")
"""The relay's own limits on joins, which the load is otherwise spared."""
EXTRA_S: Final = 3.0
"""Seconds of an offender's time beyond that of the rooms beside it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class HostileConfig:
    """Who is measured beside whom."""

    load: RelayBenchConfig
    kinds: tuple[str, ...] = tuple(KINDS)

    def __post_init__(self) -> None:
        for kind in self.kinds:
            if kind not in KINDS:
                raise OptionError(f"hostile {kind!r} is unknown; known are all, {', '.join(KINDS)}")
        if self.load.url is not None:
            raise OptionError("hostile is for a relay of one's own: leave out url")


def run_hostile_bench(config: HostileConfig) -> dict[str, Any]:
    """Measure healthy rooms with and without each offender.

    Raises:
        ClientError: A process did not do its part.
    """
    with (
        Workers() as workers,
        Children() as children,
        relay_target(config.load, children, LIMIT_ARGUMENTS) as target,
    ):
        load = Load(config.load, target, workers)
        load.connect(config.load.rooms)
        rows = [_beside(kind, config, load, target, workers) for kind in config.kinds]
        load.leave()
    return {
        "rooms": config.load.rooms,
        "peers": config.load.peers,
        "fps": config.load.fps,
        "seconds": config.load.seconds,
        "hostile": rows,
        "machine": describe_machine(),
    }


def _beside(
    kind: str, config: HostileConfig, load: Load, target: Target, workers: Workers
) -> dict[str, Any]:
    assert target.pid is not None
    rooms, seconds = config.load.rooms, config.load.seconds
    before = load.measure(rooms, seconds)
    metrics = relay_metrics(target.url)
    _forget_peak(target.pid)
    held = memory_bytes(target.pid)
    _, cores = share_cores()
    duration_s = seconds + EXTRA_S
    offender = workers.start(
        Path(clients.__file__),
        *(kind, target.url, load.room(0), f"{duration_s:g}"),
        core=cores[-1],
    )
    beside = load.measure(rooms, seconds)
    report = offender.answer(duration_s + START_TIMEOUT_S)
    workers.stop([offender])
    peak = memory_bytes(target.pid, "VmHWM")
    p99, was = beside["forward_ms"]["p99"], before["forward_ms"]["p99"]
    row = {
        "kind": kind,
        "before": _kept(before),
        "beside": _kept(beside),
        "p99_change": None if not p99 or not was else round(p99 / was - 1, 3),
        "relay_bytes": held,
        "relay_peak_bytes": peak,
        "relay_closed": _closed_since(metrics, relay_metrics(target.url)),
        "offender": report,
    }
    change = row["p99_change"]
    _say(f"{kind}: {describe(beside)}")
    _say(
        f"{kind}: p99 {was} -> {p99} ms ({'?' if change is None else f'{change:+.0%}'}), "
        f"relay's peak {(peak or 0) / 1e6:.1f} MB, relay closed {row['relay_closed']}, "
        f"offender saw {report}"
    )
    return row


def _kept(row: dict[str, Any]) -> dict[str, Any]:
    kept = (
        *("delivered_per_s", "forward_ms", "relay_forward_ms", "dropped", "missing", "errors"),
        *("relay_cpu_ratio", "generator"),
    )
    return {key: row[key] for key in kept}


def _closed_since(before: dict[str, float], after: dict[str, float]) -> dict[str, int]:
    """Connections that the relay has ended since, by close code."""
    name = "pica_closed_total{"
    changes = {
        key.partition('"')[2].partition('"')[0]: int(value - before.get(key, 0))
        for key, value in after.items()
        if key.startswith(name)
    }
    return {code: count for code, count in changes.items() if count}


def _forget_peak(pid: int) -> None:
    """Let the peak of a process's memory begin anew, where the system can."""
    with suppress(OSError):
        Path(f"/proc/{pid}/clear_refs").write_text("5")


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
