"""Charts of `pica bench playout`: what three policies make of every trouble."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib.pyplot as plt
from charting import (
    LIMITS_PAGE,
    RESULTS,
    Column,
    Line,
    Row,
    fill_in,
    finish,
    markdown_table,
    plain_ticks,
    read_lines,
    save,
    short_source,
    source_line,
    table,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure

PLAYOUT_PAGE = RESULTS / "playout.md"

POLICY_STYLE: dict[str, dict[str, Any]] = {
    "adaptive": {"color": "#0072B2", "marker": "o", "label": "ours, adaptive"},
    "fixed": {"color": "#E69F00", "marker": "s", "linestyle": "--", "label": "fixed 100 ms"},
    "unbuffered": {"color": "#777777", "marker": "^", "linestyle": ":", "label": "no buffer"},
}
"""Colours that stay apart for colour-blind eyes and in grey."""

FAMILIES = (
    ("jitter", "jitter, 95th percentile", "ms"),
    ("stall", "stall, every 2.5 s", "ms"),
    ("retransmit", "TCP segments lost", "%"),
    ("thin", "dropped by the relay", "%"),
    ("loss", "datagrams lost", "%"),
    ("reorder", "datagrams overtaken", "%"),
    ("rate", "rate of the way", "kbit/s"),
)
"""Family of scenarios, what its axis says, unit."""


def chart_playout() -> None:
    """Rendered error, delay and concealment of three policies under every trouble."""
    newest: dict[tuple[str, str], Line] = {}
    for line in read_lines("playout"):
        rows = line["result"]["rows"]
        newest[rows[0]["codec"], rows[0]["source"]] = line
    for (codec, source), line in newest.items():
        name = f"playout-{codec}-{short_source(source)}"
        save(_draw_playout(line), name)
        fill_in(LIMITS_PAGE, name, f"{_verdicts(line)}\n\n{source_line(line)}")
        fill_in(PLAYOUT_PAGE, name, f"{_playout_table(line)}\n\n{source_line(line)}")


def _split(scenario: str) -> tuple[str, int]:
    family, _, level = scenario.rpartition("-")
    return family, int(level)


def _draw_playout(line: Line) -> Figure:
    rows: list[Row] = line["result"]["rows"]
    calm = {row["policy"]: row for row in rows if row["scenario"] == "jitter-0"}
    figure, grid = plt.subplots(
        4, len(FAMILIES), figsize=(15, 9.6), sharex="col", sharey="row", layout="constrained"
    )
    figures: tuple[tuple[str, str, Callable[[Row], float]], ...] = (
        ("rendered MSE, 0–255,\nof the expression", "log", lambda row: row["mse_expression"]),
        ("added delay, ms,\n95th percentile", "log", lambda row: row["added_delay_ms_p95"]),
        ("concealed refreshes, %", "linear", lambda row: 100 * row["concealed_ratio"]),
        ("largest step ÷\nlargest true step", "linear", lambda row: row["largest_step"]),
    )
    for column, (family, label, unit) in enumerate(FAMILIES):
        chosen = [row for row in rows if _split(row["scenario"])[0] == family]
        for axis, (_, _, value) in zip(grid[:, column], figures, strict=True):
            _draw_policies(axis, chosen, None if family in ("jitter", "rate") else calm, value)
        last = grid[-1, column]
        if family == "rate":
            last.set_xscale("log", base=2)
            last.invert_xaxis()
            levels = sorted({_split(row["scenario"])[1] for row in chosen})
            last.set_xticks(levels, map(str, levels))
            last.minorticks_off()
        last.set_xlabel(f"{label}, {unit}")
    for axes, (title, scale, _) in zip(grid, figures, strict=True):
        axes[0].set_ylabel(title)
        axes[0].set_yscale(scale)
        if scale == "log":
            plain_ticks(axes[0].yaxis)
        else:
            axes[0].set_ylim(bottom=0)
    for axis in grid[3]:
        axis.axhline(1, color="black", linewidth=0.8)
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False)
    sent, result = rows[0], line["result"]
    return finish(
        figure,
        line,
        f"Playout in the troubled third of a run: {sent['source']}, {sent['codec']} format, "
        f"{sent['payload_bps'] / 1e3:.1f} kbit/s of payload, {result['fps']:g} fps on a "
        f"{result['display_hz']:g} Hz display, synthetic avatar {result['avatar']}",
    )


def _draw_policies(
    axis: Axes,
    rows: Sequence[Row],
    calm: dict[str, Row] | None,
    value: Callable[[Row], float],
) -> None:
    """One line a policy, from no trouble on."""
    for policy, style in POLICY_STYLE.items():
        points = [(_split(row["scenario"])[1], row) for row in rows if row["policy"] == policy]
        if calm is not None:
            points.append((0, calm[policy]))
        points.sort(key=lambda point: point[0])
        axis.plot([level for level, _ in points], [value(row) for _, row in points], **style)


def _playout_table(line: Line) -> str:
    columns: dict[str, Column] = {
        "trouble": lambda row: row["scenario"] if row["policy"] == "adaptive" else "",
        "policy": lambda row: POLICY_STYLE[row["policy"]]["label"],
        "MSE, moment shown": "{mse_shown:.1f}",
        "of the expression alone": "{mse_expression:.1f}",
        "MSE, now": "{mse_now:.0f}",
        "added delay p50 / p95, ms": "{added_delay_ms_p50:.0f} / {added_delay_ms_p95:.0f}",
        "concealed, longest gap": "{concealed_ratio:.1%}, {longest_gap_ms:.0f} ms",
        "late": "late",
        "face back after, ms": lambda row: _milliseconds(row["recovery_ms"]),
        "delay back after, ms": lambda row: _milliseconds(row["delay_recovery_ms"]),
        "largest step": "{largest_step:.2f}",
        "keyframes": "keyframes",
    }
    return table(line["result"]["rows"], columns)


GRADES = ("good", "usable", "broken")
GRADE_LIMITS = (
    # figure, limit of good, limit of usable, what it is called
    ("mse_expression", 16, 32, "error"),
    ("longest_gap_ms", 100, 300, "gaps"),
    ("added_delay_ms_p95", 130, 380, "delay"),
    ("largest_step", 1.5, 2.0, "jumps"),
)
"""Chosen; docs/limits-of-the-stream.md says why."""


def _grade(row: Row, calm: Row) -> tuple[str, list[str]]:
    """The worst grade of any figure, and which figures have it."""
    figures = {
        **row,
        "largest_step": row["largest_step"] / max(calm["largest_step"], 1.0),
    }
    grades = [
        (1 + (figures[figure] > usable) if figures[figure] > good else 0, name)
        for figure, good, usable, name in GRADE_LIMITS
    ]
    worst = max(grade for grade, _ in grades)
    return GRADES[worst], [name for grade, name in grades if grade == worst and worst > 0]


def _verdicts(line: Line) -> str:
    """How good the face is under every trouble and policy."""
    rows: list[Row] = line["result"]["rows"]
    by_key = {(row["scenario"], row["policy"]): row for row in rows}
    calm = by_key["jitter-0", "adaptive"]
    table = []
    for family, label, unit in FAMILIES:
        for name in dict.fromkeys(row["scenario"] for row in rows):
            if _split(name)[0] != family:
                continue
            cells = []
            for policy in POLICY_STYLE:
                grade, why = _grade(by_key[name, policy], calm)
                text = f"**{grade}**" if grade == "broken" else grade
                cells.append(f"{text} ({', '.join(why)})" if why else text)
            table.append((label, f"{_split(name)[1]} {unit}", *cells))
    header = ("trouble", "amount", *(str(style["label"]) for style in POLICY_STYLE.values()))
    return markdown_table(header, table)


def _milliseconds(value: float | None) -> str:
    return "not in the run" if value is None else f"{value:.0f}"
