"""`pica bench render`."""

from typing import Any

from pica_client.bench.render import RenderBenchConfig, run_render_bench
from pica_client.cli.bench.avatars import AvatarBenchOptions
from pica_client.output import say


def bench_render(options: AvatarBenchOptions[RenderBenchConfig]) -> dict[str, Any]:
    """Measure what drawing a head costs: near and far, each level, and a textured baseline.

    Set LP_NUM_THREADS to say how many threads software GL takes.
    """
    result = run_render_bench(options.config, options.load())
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
