"""`pica bench playout`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from tyro.conf import OmitArgPrefixes

from pica_client.bench.playout import BenchPlayoutConfig, run_bench_playout
from pica_client.cli.bench.avatars import load_bench_avatar


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchPlayoutOptions:
    """Options of ``pica bench playout``."""

    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; the first shipped one by default."""
    config: OmitArgPrefixes[BenchPlayoutConfig] = field(default_factory=BenchPlayoutConfig)


def bench_playout(options: BenchPlayoutOptions) -> dict[str, Any]:
    """Measure what the playout makes of troubled networks: rendered error, delay, recovery.

    Runs on a virtual clock and needs no network. Compares the receiver's playout with a fixed
    buffer of 100 ms and with none.
    """
    return run_bench_playout(options.config, load_bench_avatar(options.avatar))
