"""`pica bench scene` and `pica bench pareto`: error against milliseconds, of scenes and of one
face."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pica_client.cli.bench import load_bench_avatar, load_bench_avatars, read_numbers
from pica_client.output import check_writable, say


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchSceneOptions:
    """Options of ``pica bench scene``."""

    avatar: str | None = None
    """Names of shipped avatars or .pica files, separated by commas, dealt in turn; by default all
    that ship."""
    avatars: str = "1,2,3,4,5"
    """How many heads, separated by commas."""
    distances_cm: str = "65,90,120"
    """From the camera to the front of the middle head, separated by commas."""
    width: int = 1280
    """Columns of the image, pixels."""
    height: int = 720
    """Rows of the image, pixels."""
    rounds: int = 8
    """Turns of each case, of five frames each."""
    performance: str = "talk"
    """What everybody does: talk, listen or range-of-motion."""
    sheet: Path | None = None
    """Also write a picture of the nearest of the largest scenes in every treatment here, PNG."""


def bench_scene(options: BenchSceneOptions) -> dict[str, Any]:
    """Measure what a scene of talking heads costs, and the error that the scheduler leaves.

    Set LP_NUM_THREADS to say how many threads software GL takes.
    """
    from pica_client.bench.scene import SceneBenchConfig, run_scene_bench

    config = SceneBenchConfig(
        avatars=tuple(int(count) for count in read_numbers("avatars", options.avatars)),
        distances_cm=read_numbers("distances_cm", options.distances_cm),
        size=(options.width, options.height),
        rounds=options.rounds,
        performance=options.performance,
        sheet=options.sheet,
    )
    if options.sheet is not None:
        check_writable(options.sheet)
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


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchParetoOptions:
    """Options of ``pica bench pareto``."""

    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; the first shipped one by default."""
    distances_cm: str = "18,65,120"
    """From the camera to the front of the head, separated by commas."""
    image_size: int = 768
    """Rows and columns of the image, pixels."""
    frames: int = 16
    """Of each contender."""


def bench_pareto(options: BenchParetoOptions) -> dict[str, Any]:
    """Measure error against milliseconds for every level, mesh, precision and block.

    Set LP_NUM_THREADS to say how many threads software GL takes.
    """
    from pica_client.bench.pareto import ParetoBenchConfig, run_pareto_bench

    config = ParetoBenchConfig(
        distances_cm=read_numbers("distances_cm", options.distances_cm),
        image_size=options.image_size,
        frames=options.frames,
    )
    result = run_pareto_bench(config, load_bench_avatar(options.avatar))
    for row in result["rows"]:
        if row["mse"] is not None:
            say(
                f"{row['distance_cm']:5g} cm  level {row['level']:3d} mesh {row['mesh']:3d} "
                f"{row['precision']}  {row['total_ms']:7.2f} ms  MSE {row['mse']:8.3f}  "
                f"change {row['change_mse']:7.3f} {'best' if row['is_best'] else ''}"
            )
    return result
