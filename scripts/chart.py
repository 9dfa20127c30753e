"""Redraw the charts and tables of docs/ from the lines in docs/results/, without measuring.

python scripts/chart.py            all of them
python scripts/chart.py playout    one

Each takes the newest line of every kind of run it shows. Charts are SVG with a source line: date,
commit and command of what they show.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs" / "results"
LIMITS_PAGE = ROOT / "docs" / "limits-of-the-stream.md"
PLAYOUT_PAGE = RESULTS / "playout.md"

Line = dict[str, Any]
Row = dict[str, Any]

matplotlib.use("svg")
plt.rcParams.update(
    {
        "svg.fonttype": "none",  # text stays text: small files, searchable
        "svg.hashsalt": "pica",  # the same bytes for the same data
        "font.family": "sans-serif",
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.alpha": 0.3,
        "lines.markersize": 4,
    }
)

POLICY_STYLE = {
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


def read_lines(name: str) -> list[Line]:
    """All lines of docs/results/NAME.jsonl, oldest first."""
    path = RESULTS / f"{name}.jsonl"
    return [json.loads(text) for text in path.read_text().splitlines()] if path.exists() else []


def source_line(line: Line) -> str:
    """What a chart says of its data."""
    return f"{line['date']} · commit {line['commit']} · {line['command']}"


def save(figure: Figure, name: str) -> None:
    """Write docs/results/NAME.svg."""
    path = RESULTS / f"{name}.svg"
    figure.savefig(path, metadata={"Date": None, "Creator": "scripts/chart.py"})
    plt.close(figure)
    # matplotlib leaves blanks at the ends of lines
    path.write_text("\n".join(text.rstrip() for text in path.read_text().splitlines()) + "\n")
    print(f"wrote {path.relative_to(ROOT)}")


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table; None becomes a dash."""
    lines = [" | ".join(header), " | ".join("---" for _ in header)]
    lines += [" | ".join("–" if cell is None else str(cell) for cell in row) for row in rows]
    return "\n".join(f"| {line} |" for line in lines)


def fill_in(page: Path, mark: str, text: str) -> None:
    """Replace what stands between ``<!-- MARK -->`` and ``<!-- end MARK -->`` of a page."""
    begin, end = f"<!-- {mark} -->", f"<!-- end {mark} -->"
    before, found, rest = page.read_text().partition(begin)
    _, found_end, after = rest.partition(end)
    if not (found and found_end):
        sys.exit(f"{page.relative_to(ROOT)} has no place for {mark!r}")
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}")
    print(f"filled {mark} into {page.relative_to(ROOT)}")


# Playout


def chart_playout() -> None:
    """Rendered error, delay and concealment of three policies under every trouble."""
    newest: dict[tuple[str, str], Line] = {}
    for line in read_lines("playout"):
        rows = line["result"]["rows"]
        newest[rows[0]["codec"], rows[0]["source"]] = line
    for (codec, source), line in newest.items():
        name = f"playout-{codec}-{_short(source)}"
        save(_draw_playout(line), name)
        fill_in(LIMITS_PAGE, name, f"{_verdicts(line)}\n\n{source_line(line)}")
        fill_in(PLAYOUT_PAGE, name, f"{_playout_table(line)}\n\n{source_line(line)}")


def _short(source: str) -> str:
    """A source's name without folder and ending."""
    kind, _, name = source.partition(":")
    stem = Path(name).stem.replace("_", "-")
    return f"recording-{stem}" if kind == "csv" else stem


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
            ticks = LogLocator(base=10, subs=(1, 2, 5))
            axes[0].yaxis.set_major_locator(ticks)
            axes[0].yaxis.set_minor_locator(NullLocator())
            axes[0].yaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
        else:
            axes[0].set_ylim(bottom=0)
    for axis in grid[3]:
        axis.axhline(1, color="black", linewidth=0.8)
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False)
    sent = rows[0]
    figure.suptitle(
        f"Playout in the troubled third of a run: {sent['source']}, {sent['codec']} format, "
        f"{sent['payload_bps'] / 1e3:.1f} kbit/s of payload, {line['result']['fps']:g} fps on a "
        f"{line['result']['display_hz']:g} Hz display, synthetic avatar {line['result']['avatar']}",
        fontsize=10,
    )
    figure.supxlabel(source_line(line), fontsize=7, color="#555555")
    return figure


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
    header = (
        "trouble",
        "policy",
        "MSE, moment shown",
        "of the expression alone",
        "MSE, now",
        "added delay p50 / p95, ms",
        "concealed, longest gap",
        "late",
        "face back after, ms",
        "delay back after, ms",
        "largest step",
        "keyframes",
    )
    rows = []
    for row in line["result"]["rows"]:
        is_first = row["policy"] == "adaptive"
        rows.append(
            (
                row["scenario"] if is_first else "",
                POLICY_STYLE[row["policy"]]["label"],
                f"{row['mse_shown']:.1f}",
                f"{row['mse_expression']:.1f}",
                f"{row['mse_now']:.0f}",
                f"{row['added_delay_ms_p50']:.0f} / {row['added_delay_ms_p95']:.0f}",
                f"{row['concealed_ratio']:.1%}, {row['longest_gap_ms']:.0f} ms",
                row["late"],
                _milliseconds(row["recovery_ms"]),
                _milliseconds(row["delay_recovery_ms"]),
                f"{row['largest_step']:.2f}",
                row["keyframes"],
            )
        )
    return markdown_table(header, rows)


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


# Real calls through a bad network


def chart_impaired_call() -> None:
    """Rendered error and age of the face in real calls, by what was done to their network."""
    newest = {line["command"]: line for line in read_lines("impaired-call")}
    lines = list(newest.values())
    if not lines:
        return
    save(_draw_impaired_calls(lines), "impaired-call")
    header = (
        "network",
        "peers",
        "sample to decoded p50 / p95, ms",
        "age on the display p50 / p95, ms",
        "MSE, usual delay",
        "MSE, now",
        "concealed",
        "largest step",
    )
    rows = []
    for line in lines:
        result = line["result"]
        rendered, latency = result["rendered"], result["latency_ms"]
        rows.append(
            (
                _network(line),
                result["peers"],
                f"{latency['p50']:.0f} / {latency['p95']:.0f}",
                f"{rendered['age_ms']['p50']:.0f} / {rendered['age_ms']['p95']:.0f}",
                f"{rendered['mse_delayed']:.1f}",
                f"{rendered['mse_now']:.0f}",
                f"{rendered['concealed_ratio']:.1%}",
                f"{rendered['largest_step']:.2f}",
            )
        )
    newest_line = lines[-1]
    source = f"{newest_line['date']} · commit {newest_line['commit']} · pica bench call"
    fill_in(LIMITS_PAGE, "impaired-call", f"{markdown_table(header, rows)}\n\n{source}")


def _network(line: Line) -> str:
    """What a line's command did to the network, in words."""
    way = line["result"]["impairment"]
    parts = []
    if way["jitter_s"]:
        parts.append(f"jitter {way['jitter_s'] * 1e3:g} ms")
    if way["stall_s"]:
        parts.append(f"stalls {way['stall_s'] * 1e3:g} ms")
    if way["loss_ratio"]:
        parts.append(f"{way['loss_ratio']:.0%} lost")
    if way["rate_bps"]:
        parts.append(f"{way['rate_bps'] / 1e3:g} kbit/s")
    if "--plain" in line["command"]:
        parts.append("plain 8 bit")
    return ", ".join(parts) or "no trouble"


def _draw_impaired_calls(lines: Sequence[Line]) -> Figure:
    figure, (errors, ages) = plt.subplots(
        2, 1, figsize=(max(0.95 * len(lines), 6), 5.6), sharex=True, layout="constrained"
    )
    places = range(len(lines))
    rendered = [line["result"]["rendered"] for line in lines]
    errors.plot(places, [row["mse_delayed"] for row in rendered], "o", label="at its usual delay")
    errors.plot(places, [row["mse_now"] for row in rendered], "^", label="now", color="#777777")
    errors.set_yscale("log")
    errors.set_ylabel("rendered MSE, 0–255,\nagainst the undisturbed stream")
    errors.yaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
    errors.legend(frameon=False)
    for percent, marker in (("p50", "o"), ("p95", "_")):
        ages.plot(
            places,
            [row["age_ms"][percent] for row in rendered],
            marker,
            label=percent,
            color="#0072B2",
        )
    ages.set_yscale("log")
    ages.yaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
    ages.set_ylabel("age of the face\non the display, ms")
    ages.legend(frameon=False)
    ages.set_xticks(list(places), [_network(line).replace(", ", ",\n") for line in lines])
    ages.tick_params(axis="x", labelsize=7)
    figure.suptitle(
        f"Real calls of {lines[0]['result']['peers']} peers through a worse network, "
        f"{lines[0]['result']['impairment']['delay_s'] * 1e3:g} ms each way",
        fontsize=10,
    )
    figure.supxlabel(
        f"{lines[-1]['date']} · commit {lines[-1]['commit']} · pica bench call on loopback",
        fontsize=7,
        color="#555555",
    )
    return figure


CHARTS: dict[str, Callable[[], None]] = {
    "playout": chart_playout,
    "impaired-call": chart_impaired_call,
}


def main() -> None:
    """Draw what is named, or all."""
    names = sys.argv[1:] or list(CHARTS)
    for name in names:
        if name not in CHARTS:
            sys.exit(f"chart {name!r} is unknown; known are {', '.join(CHARTS)}")
        CHARTS[name]()


if __name__ == "__main__":
    main()
