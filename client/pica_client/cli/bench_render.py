"""`pica bench render` and `pica avatar measure`: what drawing costs, and what levels lose."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from pica_client.cli.bench import load_bench_avatar, read_numbers
from pica_client.output import check_writable, say


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchRenderOptions:
    """Options of ``pica bench render``."""

    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; the first shipped one by default."""
    distances_cm: str = "18,65,120"
    """From the camera to the front of the head, separated by commas."""
    image_size: int = 1024
    """Rows and columns of the image, pixels."""
    rounds: int = 15
    """Frames drawn of each case."""
    sweep_points: int = 12
    """Distances of the sweep over pixels."""
    soak_frames: int = 0
    """Then draw so many small frames and watch the memory."""


def bench_render(options: BenchRenderOptions) -> dict[str, Any]:
    """Measure what drawing a head costs, near and far, at every level, beside a textured baseline.

    Set LP_NUM_THREADS to say how many threads software GL takes.
    """
    from pica_client.bench.render import RenderBenchConfig, run_render_bench

    config = RenderBenchConfig(
        distances_cm=read_numbers("distances_cm", options.distances_cm),
        image_size=options.image_size,
        rounds=options.rounds,
        sweep_points=options.sweep_points,
        soak_frames=options.soak_frames,
    )
    result = run_render_bench(config, load_bench_avatar(options.avatar))
    for row in result["rows"]:
        name = f"{row['model']} {row['level'] or ''}".strip()
        say(
            f"{row['distance_cm']:6g} cm  {name:10} mesh {row['mesh']:3d}  "
            f"{row['weights'] or '':9}  {row['pixels']:8d} px  {row['triangles']:6d} triangles  "
            f"draw {row['draw_ms']:8.2f} ms  vertices {row['vertex_ms']:6.2f} ms  "
            f"processor {row['draw_cpu_ms']:8.2f} ms, {row['vertex_cpu_ms']:6.2f} ms"
        )
    for line in result["lines"]:
        name = f"{line['model']} {line['level'] or ''}".strip()
        say(
            f"{name}, {line['time']}: {line['intercept_ms']:.2f} ms + "
            f"{line['ns_per_pixel']:.1f} ns a pixel, r2 {line['r2']:.4f}"
        )
    return result


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarMeasureOptions:
    """Options of ``pica avatar measure``."""

    file: tyro.conf.Positional[Path]
    """Avatar file (.pica)."""
    out: Path
    """Avatar file to write, with the table of errors in it; may be the same."""


def avatar_measure(options: AvatarMeasureOptions) -> dict[str, Any]:
    """Measure how well an avatar's levels of detail serve, and write the table into its file."""
    from pica_client.bench.level_measure import measure_levels, with_errors
    from pica_core.avatar.file import avatar_id, load_avatar, save_avatar

    check_writable(options.out)
    avatar = load_avatar(options.file)
    errors = measure_levels(avatar, lambda ratio: say(f"{ratio:.0%}"))
    save_avatar(options.out, with_errors(avatar, errors))
    rows: list[dict[str, Any]] = []
    full = avatar.levels[-1]
    for mesh, by_maps in zip(errors.levels, errors.mse.tolist(), strict=True):
        ways = {mesh: by_maps[0], full: by_maps[1]}  # the full level's two are one
        for level, by_height in ways.items():
            rows.append({"level": level, "mesh": mesh, "mse": by_height})
            figures = "  ".join(
                f"{height:g} px {error:.1f}"
                for height, error in zip(errors.head_px.tolist(), by_height, strict=True)
            )
            say(f"maps of {level} on the mesh of {mesh}: MSE {figures}")
    say(f"wrote {options.out}")
    return {
        "name": avatar.manifest.name,
        "sha256": avatar_id(options.out),
        "head_px": errors.head_px.tolist(),
        "rows": rows,
        "view_mse_per_rad2": errors.view_mse_per_rad2,
        "latent_mse_per_unit2": errors.latent_mse_per_unit2,
    }
