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
        fill_in(LIMITS_PAGE, name, f"{_playout_table(line)}\n\n{source_line(line)}")


def _short(source: str) -> str:
    """A source's name without its kind, folder and ending."""
    return Path(source.partition(":")[2]).stem.replace("_", "-")


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
        ("rendered MSE, 0–255,\nagainst the moment shown", "log", lambda row: row["mse_shown"]),
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
        "MSE, now",
        "added delay p50 / p95, ms",
        "concealed",
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
                f"{row['mse_now']:.0f}",
                f"{row['added_delay_ms_p50']:.0f} / {row['added_delay_ms_p95']:.0f}",
                f"{row['concealed_ratio']:.1%}",
                row["late"],
                _milliseconds(row["recovery_ms"]),
                _milliseconds(row["delay_recovery_ms"]),
                f"{row['largest_step']:.2f}",
                row["keyframes"],
            )
        )
    return markdown_table(header, rows)


def _milliseconds(value: float | None) -> str:
    return "not in the run" if value is None else f"{value:.0f}"


CHARTS: dict[str, Callable[[], None]] = {"playout": chart_playout}


def main() -> None:
    """Draw what is named, or all."""
    names = sys.argv[1:] or list(CHARTS)
    for name in names:
        if name not in CHARTS:
            sys.exit(f"chart {name!r} is unknown; known are {', '.join(CHARTS)}")
        CHARTS[name]()


if __name__ == "__main__":
    main()
