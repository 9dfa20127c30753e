"""What a receiver spends and what error that leaves: decoding, drawing, one face, whole scenes."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
from charting import (
    COLOURS,
    RESULTS,
    Column,
    Line,
    Row,
    fill_in,
    finish,
    plain_ticks,
    read_lines,
    rows_where,
    save,
    source_line,
    table,
    values,
)
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

PAGE = RESULTS / "receiver.md"
MARKERS = {64: "v", 128: "s", 256: "o"}
COST_BAR = 1.5
"""Several heads may cost so many times what one costs that fills the screen."""


def chart_receiver() -> None:
    """The newest line of every kind."""
    draws = {"render": _draw_render, "pareto": _draw_pareto, "scene": _draw_scene}
    tables = {
        "decode": _decode_tables,
        "render": _render_tables,
        "pareto": _pareto_table,
        "scene": _scene_tables,
    }
    for name, make in tables.items():
        if lines := read_lines(name):
            if name in draws:
                save(finish(draws[name](lines[-1]), lines[-1], size=6), name)
            fill_in(PAGE, name, "\n\n".join([*make(lines[-1]["result"]), source_line(lines[-1])]))


def _decode_tables(result: Row) -> list[str]:
    ratios = [
        {"threads": threads, "model": model, "level": level}
        | {name: by_level[name][level] for name in by_level}
        for threads, models in result["summary"]["by_threads"].items()
        for model, by_level in models.items()
        for level in by_level["baseline_ratio"]
    ]
    return [
        table(
            ratios,
            {
                **{name: name for name in ("threads", "model", "level")},
                "baseline ÷ it": "baseline_ratio",
                "plain ÷ it": "plain_ratio",
                "full level ÷ it": "level_ratio",
            },
        ),
        f"A talking head {result['head_px']:g} pixels high is given level "
        f"{result['summary']['level_at_head_px']} while there is time.",
        table(
            result["rows"],
            {
                "model": "model",
                "level": "level",
                "maps": "parts",
                "threads": "threads",
                "ms": "ms",
                "p95": "p95",
                "plain export, ms": "plain_ms",
                "vertices, mm": "vertex_mm",
            },
        ),
    ]


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
    return figure


def _render_tables(result: Row) -> list[str]:
    ratios = {
        (row["distance_cm"], row["level"], row["mesh"]): row for row in result["summary"]["ratios"]
    }
    rows = [
        row | {"ratio": ratios.get((row["distance_cm"], row["level"], row["mesh"]), {})}
        for row in _own(result)
    ]
    shown = table(
        rows,
        {
            "cm": "{distance_cm:g}",
            "model": "model",
            "level": lambda row: row["level"] or None,
            "mesh": lambda row: row["mesh"] or None,
            "pixels": "{pixels:,}",
            "triangles": "{triangles:,}",
            "draw, ms": "draw_ms",
            "of processor": "draw_cpu_ms",
            "vertices, of processor": "vertex_cpu_ms",
            "draw ÷ baseline": lambda row: row["ratio"].get("draw_over_baseline"),
            "of processor ÷ baseline": lambda row: row["ratio"].get("draw_cpu_over_baseline"),
            "vertices ÷ full mesh": lambda row: row["ratio"].get("vertex_cpu_over_full"),
        },
    )
    full = _full(result)
    weights = table(
        rows_where(result["rows"], model="pica", level=full, mesh=full),
        {
            "cm": "{distance_cm:g}",
            "weights": "weights",
            "draw, ms": "draw_ms",
            "of processor": "draw_cpu_ms",
        },
    )
    texts = [shown, weights]
    if (soak := result.get("soak")) is not None:
        texts.append(
            f"{soak['frames']:,} small frames with fresh maps: "
            f"{soak['resident_mb_after_a_tenth']} MB resident after a tenth of them, "
            f"{soak['resident_mb_at_the_end']} MB at the end."
        )
    return texts


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
    looks = [
        *({"marker": MARKERS[level], "label": f"{level}²"} for level in (256, 128, 64)),
        {"marker": "o", "fillstyle": "none", "label": "coarser mesh"},
        *({"marker": "o", "color": colours[kind], "label": kind} for kind in colours),
    ]
    plain: dict[str, Any] = {"color": "#555555", "linestyle": ""}
    handles = [Line2D([], [], **plain | look) for look in looks]
    figure.legend(handles=handles, loc="outside upper center", ncols=7, frameon=False, fontsize=7)
    return figure


def _pareto_table(result: Row) -> list[str]:
    columns: dict[str, Column] = {
        "cm": "{distance_cm:g}",
        "model": "model",
        "level": "level",
        "mesh": "mesh",
        "weights": "precision",
        "file, MB": lambda row: row["file_bytes"] and f"{row['file_bytes'] / 1e6:.2f}",
        "decode, ms": "decode_ms",
        "draw, ms": "draw_ms",
        "MSE": "mse",
        "MSE of change": "change_mse",
        "best": lambda row: "yes" if row["is_best"] else "",
    }
    return [table(result["rows"], columns)]


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
    for axis, label in (
        (error, "talking heads, no budget"),
        (budget, f"{most} heads on a budget:\nspent over unconstrained"),
    ):
        axis.set_ylabel("MSE given up, 0–255")
        axis.set_xlabel(label)
        axis.set_ylim(bottom=0)
    return figure


def _scene_tables(result: Row) -> list[str]:
    summary = result["summary"]
    most = max(values(result["rows"], "avatars"))
    shares: dict[str, Column] = {
        "levels": lambda row: _shares(row["levels"]),
        "meshes": lambda row: _shares(row["meshes"]),
    }
    scenes: dict[str, Column] = {
        "cm": "{distance_cm:g}",
        f"{most} heads over one that fills the screen": "scheduled_over_full_screen",
        "without the scheduler": "unscheduled_over_full_screen",
        "MSE": "error",
    }
    budgets: dict[str, Column] = {
        "cm": "{distance_cm:g}",
        "budget": "budget_over_free",
        "floor": "floor_over_free",
        "spent (all over unconstrained)": "spent_over_free",
        "MSE": "error",
        "rise": "error_rise",
        "heads limited": "{limited:.0%}",
    }
    rows: dict[str, Column] = {
        "heads": lambda row: f"{row['avatars']}{'' if row['view'] == 'front' else ', none seen'}",
        "cm": "{distance_cm:g}",
        "scheduler": lambda row: "yes" if row["scheduler"] else "no",
        "budget, ms": "budget_ms",
        "total, ms": "total_ms",
        **{part: f"{part}_ms" for part in ("decode", "upload", "draw", "plan")},
        "decodes a frame": "decodes",
        "MSE": "error",
        "kbit/s": lambda row: round(row["payload_bps"] / 1e3, 2),
    }
    texts = [table(summary["scenes"], scenes), table(summary["budgets"], budgets | shares)]
    if (away := summary.get("away")) is not None:
        texts.append(
            f"With nobody on the screen: {away['decodes']:g} decodes a frame, "
            f"{away['payload_over_seen']:.1%} of the payload."
        )
    return [*texts, table(result["rows"], rows | shares)]


def _shares(counts: dict[str, Any]) -> str:
    """How often what, in percent."""
    total = sum(counts.values())
    return ", ".join(f"{name}: {count / total:.0%}" for name, count in counts.items())
