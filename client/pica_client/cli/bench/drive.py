"""`pica bench drive`: avatars as a live face drives them, against the head itself."""

from dataclasses import dataclass
from typing import Any

from tyro.conf import OmitArgPrefixes

from pica_client.bench.drive.bench import DriveBenchConfig, run_drive_bench
from pica_client.cli.bench.avatars import load_bench_avatars
from pica_client.output import say


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchDriveOptions:
    """Options of `pica bench drive`."""

    avatar: str | None = None
    """Names of shipped avatars or .pica files, separated by commas; by default all that ship."""
    config: OmitArgPrefixes[DriveBenchConfig]


def bench_drive(options: BenchDriveOptions) -> dict[str, Any]:
    """Measure what a live face becomes at every level: picture, lids, lips, what pokes out.

    The truth is the built-in head or the rig itself, at the same values.
    """
    result = run_drive_bench(options.config, load_bench_avatars(options.avatar))
    for row in result["rows"]:
        say(
            f"{row['avatar']:8} {row['source']:28} {row['stage']:10} {row['level']:3d}  "
            f"MSE {row['mse']:7.2f}  p95 {row['p95_mse']:7.2f}  lids {row['lid_mm']:.2f} mm  "
            f"lips {row['lip_mm']:.2f} mm  poke {row['poke_ratio']:.3%}"
        )
    return result
