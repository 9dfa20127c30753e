"""What a receiver spends and what error that leaves: decoding, drawing, one face, whole scenes."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
from charting import (
    COLOURS,
    RESULTS,
    Line,
    Row,
    fill_in,
    markdown_table,
    plain_ticks,
    read_lines,
    save,
    source_line,
)
from matplotlib.figure import Figure

PAGE = RESULTS / "receiver.md"
MARKERS = {64: "v", 128: "s", 256: "o"}
COST_BAR = 1.5
"""Several heads may cost so many times what one costs that fills the screen."""


def chart_receiver() -> None:
    """The newest line of every kind."""
    if lines := read_lines("decode"):
        fill_in(PAGE, "decode", _decode_tables(lines[-1]))
    if lines := read_lines("render"):
        save(_draw_render(lines[-1]), "render")
        fill_in(PAGE, "render", _render_table(lines[-1]))
    if lines := read_lines("pareto"):
        save(_draw_pareto(lines[-1]), "pareto")
        fill_in(PAGE, "pareto", _pareto_table(lines[-1]))
    if lines := read_lines("scene"):
        save(_draw_scene(lines[-1]), "scene")
        fill_in(PAGE, "scene", _scene_tables(lines[-1]))


def _decode_tables(line: Line) -> str:
    result = line["result"]
    header = ("model", "level", "maps", "threads", "ms", "p95", "plain export, ms", "vertices, mm")
    rows = [
        (
            row["model"],
            row["level"],
            row["parts"],
            row["threads"],
            row["ms"],
            row["p95"],
            row["plain_ms"],
            row["vertex_mm"],
        )
        for row in result["rows"]
    ]
    ratios = []
    for threads, models in result["summary"]["by_threads"].items():
        for model, by_level in models.items():
            for level, ratio in by_level["baseline_ratio"].items():
                plain, full = (by_level[key][level] for key in ("plain_ratio", "level_ratio"))
                ratios.append((threads, model, level, ratio, plain, full))
    names = ("threads", "model", "level", "baseline ÷ it", "plain ÷ it", "full level ÷ it")
    height, level = result["head_px"], result["summary"]["level_at_head_px"]
    return (
        f"{markdown_table(names, ratios)}\n\nA talking head {height:g} pixels high is given level "
        f"{level} while there is time.\n\n{markdown_table(header, rows)}\n\n{source_line(line)}"
    )


def _own(result: Row) -> list[Row]:
    """Rows of the table with the weights where the renderer would put them."""
    full = _full(result)
    chosen = {row["weights"] for row in result["rows"] if row["level"] not in (full, 0)}
    return [row for row in result["rows"] if row["weights"] in chosen | {None}]


def _draw_render(line: Line) -> Figure:
    result = line["result"]
    figure, axis = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    # Software GL shares its processor with whatever else runs; its processor time does not.
    time, what = ("draw_ms", "drawing a frame, ms")
    if "llvmpipe" in result["gl_renderer"]:
        time, what = ("draw_cpu_ms", "drawing a frame, ms of processor")
    fits = [line for line in result["lines"] if line["time"] == time]
    for fit, colour in zip(fits, COLOURS, strict=False):
        kind = (fit["model"], fit["level"])
        rows = [row for row in result["sweep"] if (row["model"], row["level"]) == kind]
        pixels = [row["pixels"] / 1e3 for row in rows]
        name = f"PiCA, level {fit['level']}" if fit["level"] else "textured baseline"
        formula = f"{fit['intercept_ms']:.1f} ms + {fit['ns_per_pixel']:.0f} ns/pixel"
        label = f"{name}: {formula}, r² {fit['r2']:.3f}"
        axis.plot(pixels, [row[time] for row in rows], "o", color=colour, label=label)
        ends = [0.0, max(pixels)]
        axis.plot(
            ends,
            [fit["intercept_ms"] + fit["ns_per_pixel"] * 1e-3 * end for end in ends],
            color=colour,
            linewidth=0.8,
        )
    axis.set_xlabel("covered pixels, thousands")
    axis.set_ylabel(what)
    axis.set_ylim(bottom=0)
    axis.legend(frameon=False, fontsize=8)
    figure.suptitle(f"Drawing one head: {result['gl_renderer'].partition(' (')[0]}", fontsize=10)
    figure.supxlabel(source_line(line), fontsize=6, color="#555555")
    return figure


def _render_table(line: Line) -> str:
    result = line["result"]
    ratios = {
        (row["distance_cm"], row["level"], row["mesh"]): row for row in result["summary"]["ratios"]
    }
    header = (
        *("cm", "model", "level", "mesh", "pixels", "triangles", "draw, ms", "of processor"),
        *("vertices, of processor", "draw ÷ baseline", "of processor", "vertices ÷ full mesh"),
    )
    rows = []
    for row in _own(result):
        ratio = ratios.get((row["distance_cm"], row["level"], row["mesh"]), {})
        rows.append(
            (
                f"{row['distance_cm']:g}",
                row["model"],
                row["level"] or None,
                row["mesh"] or None,
                f"{row['pixels']:,}",
                f"{row['triangles']:,}",
                row["draw_ms"],
                row["draw_cpu_ms"],
                row["vertex_cpu_ms"],
                ratio.get("draw_over_baseline"),
                ratio.get("draw_cpu_over_baseline"),
                ratio.get("vertex_cpu_over_full"),
            )
        )
    places = [
        (f"{row['distance_cm']:g}", row["weights"], row["draw_ms"], row["draw_cpu_ms"])
        for row in result["rows"]
        if row["model"] == "pica" and row["level"] == row["mesh"] == _full(result)
    ]
    weights = markdown_table(("cm", "weights", "draw, ms", "of processor"), places)
    soak = result.get("soak")
    kept = (
        ""
        if soak is None
        else f"\n\n{soak['frames']:,} small frames with fresh maps: "
        f"{soak['resident_mb_after_a_tenth']} MB resident after a tenth of them, "
        f"{soak['resident_mb_at_the_end']} MB at the end."
    )
    return f"{markdown_table(header, rows)}\n\n{weights}{kept}\n\n{source_line(line)}"


def _full(result: Row) -> int:
    return int(max(row["level"] for row in result["rows"]))


def _draw_pareto(line: Line) -> Figure:
    result = line["result"]
    distances = sorted({row["distance_cm"] for row in result["rows"]})
    figure, axes = plt.subplots(
        1, len(distances), figsize=(7.2, 3.4), sharey=True, layout="constrained", squeeze=False
    )
    colours = {"f32": COLOURS[0], "f16": COLOURS[2], "u8": COLOURS[1]}
    for axis, distance in zip(axes[0], distances, strict=True):
        here = [row for row in result["rows"] if row["distance_cm"] == distance]
        best = sorted(
            ((row["total_ms"], row["mse"]) for row in here if row["is_best"]), key=lambda at: at[0]
        )
        axis.plot(*zip(*best, strict=True), color="#bbbbbb", zorder=0)
        for row in (row for row in here if row["mse"] is not None):
            is_whole = row["mesh"] == row["level"]
            axis.plot(
                row["total_ms"],
                row["mse"],
                MARKERS.get(row["level"], "D"),
                color=colours[row["precision"]],
                fillstyle="full" if is_whole else "none",
            )
        axis.set_title(f"{distance:g} cm", fontsize=9)
        axis.set_xlim(left=0)
        axis.set_yscale("log")
        plain_ticks(axis.yaxis)
    axes[0][0].set_ylabel("MSE, 0–255")
    axes[0][len(distances) // 2].set_xlabel("decode + draw, ms")
    handles = [
        *(
            plt.Line2D([], [], marker=MARKERS[level], color="#555555", linestyle="", label=label)
            for level, label in ((256, "256²"), (128, "128²"), (64, "64²"))
        ),
        plt.Line2D(
            [],
            [],
            marker="o",
            color="#555555",
            linestyle="",
            fillstyle="none",
            label="coarser mesh",
        ),
        *(
            plt.Line2D([], [], marker="o", color=colours[kind], linestyle="", label=kind)
            for kind in ("f32", "f16", "u8")
        ),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=7, frameon=False, fontsize=7)
    figure.supxlabel(source_line(line), fontsize=6, color="#555555")
    return figure


def _pareto_table(line: Line) -> str:
    header = (
        *("cm", "model", "level", "mesh", "weights", "file, MB", "decode, ms", "draw, ms"),
        *("MSE", "MSE of change", "best"),
    )
    rows = [
        (
            f"{row['distance_cm']:g}",
            row["model"],
            row["level"],
            row["mesh"],
            row["precision"],
            None if row["file_bytes"] is None else f"{row['file_bytes'] / 1e6:.2f}",
            row["decode_ms"],
            row["draw_ms"],
            row["mse"],
            row["change_mse"],
            "yes" if row["is_best"] else "",
        )
        for row in line["result"]["rows"]
    ]
    return f"{markdown_table(header, rows)}\n\n{source_line(line)}"


def _draw_scene(line: Line) -> Figure:
    result = line["result"]
    rows, full_ms = result["rows"], result["summary"]["full_screen_ms"]
    most = max(row["avatars"] for row in rows)
    distances = sorted({scene["distance_cm"] for scene in result["summary"]["scenes"]})
    figure, axes = plt.subplots(1, 3, figsize=(9.6, 3.4), layout="constrained")
    cost, error, budget = axes
    for distance, colour in zip(distances, COLOURS, strict=False):
        seen = [
            row
            for row in rows
            if row["distance_cm"] == distance and row["view"] == "front" and not row["budget_ms"]
        ]
        for is_scheduled, style in ((True, "-o"), (False, "--x")):
            chosen = [row for row in seen if row["scheduler"] is is_scheduled]
            counts = [row["avatars"] for row in chosen]
            label = f"{distance:g} cm" if is_scheduled else None
            cost.plot(
                counts,
                [row["total_ms"] / full_ms for row in chosen],
                style,
                color=colour,
                label=label,
            )
            if is_scheduled:
                error.plot(counts, [row["error"] for row in chosen], style, color=colour)
        free = next(row for row in seen if row["scheduler"] and row["avatars"] == most)
        limited = [free] + [
            row for row in rows if row["distance_cm"] == distance and row["budget_ms"]
        ]
        budget.plot(
            [row["total_ms"] / free["total_ms"] for row in limited],
            [row["error"] for row in limited],
            "-o",
            color=colour,
        )
    cost.axhline(COST_BAR, color="#333333", linewidth=0.8, linestyle=":")
    cost.set_ylabel("cost over one head that fills the screen")
    cost.set_xlabel("talking heads, 25 cm apart\n(dashed: without the scheduler)")
    cost.legend(frameon=False, fontsize=8)
    cost.set_ylim(bottom=0)
    error.set_ylabel("MSE given up, 0–255")
    error.set_xlabel("talking heads, no budget")
    error.set_ylim(bottom=0)
    budget.set_ylabel("MSE given up, 0–255")
    budget.set_xlabel(f"{most} heads on a budget:\nspent over unconstrained")
    budget.set_ylim(bottom=0)
    figure.supxlabel(source_line(line), fontsize=6, color="#555555")
    return figure


def _scene_tables(line: Line) -> str:
    result = line["result"]
    header = (
        *("heads", "cm", "scheduler", "budget, ms", "total, ms", "decode", "upload", "draw"),
        *("plan", "decodes a frame", "MSE", "kbit/s", "levels", "meshes"),
    )
    rows = [
        (
            row["avatars"] if row["view"] == "front" else f"{row['avatars']}, none seen",
            f"{row['distance_cm']:g}",
            "yes" if row["scheduler"] else "no",
            row["budget_ms"],
            row["total_ms"],
            row["decode_ms"],
            row["upload_ms"],
            row["draw_ms"],
            row["plan_ms"],
            row["decodes"],
            row["error"],
            round(row["payload_bps"] / 1e3, 2),
            _shares(row["levels"]),
            _shares(row["meshes"]),
        )
        for row in result["rows"]
    ]
    summary = result["summary"]
    scenes = [
        (
            f"{scene['distance_cm']:g}",
            scene["scheduled_over_full_screen"],
            scene["unscheduled_over_full_screen"],
            scene["error"],
        )
        for scene in summary["scenes"]
    ]
    budgets = [
        (
            f"{row['distance_cm']:g}",
            row["budget_over_free"],
            row["floor_over_free"],
            row["spent_over_free"],
            row["error"],
            row["error_rise"],
            f"{row['limited']:.0%}",
            _shares(row["levels"]),
            _shares(row["meshes"]),
        )
        for row in summary["budgets"]
    ]
    most = max(row["avatars"] for row in result["rows"])
    away = summary.get("away")
    text = markdown_table(
        ("cm", f"{most} heads over one that fills the screen", "without the scheduler", "MSE"),
        scenes,
    )
    text += "\n\n" + markdown_table(
        (
            *("cm", "budget", "floor", "spent (all over unconstrained)", "MSE", "rise"),
            *("heads limited", "levels", "meshes"),
        ),
        budgets,
    )
    if away is not None:
        text += (
            f"\n\nWith nobody on the screen: {away['decodes']:g} decodes a frame, "
            f"{away['payload_over_seen']:.1%} of the payload."
        )
    return f"{text}\n\n{markdown_table(header, rows)}\n\n{source_line(line)}"


def _shares(counts: dict[str, Any]) -> str:
    """How often what, in percent."""
    total = sum(counts.values())
    return ", ".join(f"{name}: {count / total:.0%}" for name, count in counts.items())
