"""`pica bench scene`: error against milliseconds of scenes of several heads."""

from dataclasses import dataclass
from typing import Any

from tyro.conf import OmitArgPrefixes

from pica_client.bench.scene import SceneBenchConfig, run_scene_bench
from pica_client.cli.bench.avatars import load_bench_avatars
from pica_client.output import check_writable, say


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchSceneOptions:
    """Options of `pica bench scene`."""

    avatar: str | None = None
    """Names of shipped avatars or .pica files, separated by commas, dealt in turn; by default all
    that ship."""
    config: OmitArgPrefixes[SceneBenchConfig]


def bench_scene(options: BenchSceneOptions) -> dict[str, Any]:
    """Measure a scene of talking heads: its cost, and the error that the scheduler leaves.

    Set LP_NUM_THREADS to say how many threads software GL takes.
    """
    config = options.config
    if config.sheet is not None:
        check_writable(config.sheet, ".png")
    result = run_scene_bench(config, load_bench_avatars(options.avatar))
    for row in result["rows"]:
        budget = "" if row["budget_ms"] is None else f"of {row['budget_ms']:g}"
        error = "" if row["error"] is None else f"error {row['error']:7.3f}"
        say(
            f"{row['avatars']} at {row['distance_cm']:5g} cm {row['view']:5} "
            f"{'scheduled' if row['scheduler'] else 'all whole':9} "
            f"{row['total_ms']:8.2f} ms {budget:9} (decode {row['decode_ms']:6.2f}, upload "
            f"{row['upload_ms']:5.2f}, draw {row['draw_ms']:7.2f}, plan {row['plan_ms']:5.2f}) "
            f"{error}  {row['payload_bps'] / 1e3:6.2f} kbit/s"
        )
    for scene in result["summary"]["scenes"]:
        say(
            f"{max(config.avatars)} heads at {scene['distance_cm']:g} cm cost "
            f"{scene['scheduled_over_full_screen']:.2f} of one that fills the screen, "
            f"{scene['unscheduled_over_full_screen']:.2f} without the scheduler; "
            f"error {scene['error']}"
        )
    return result
