"""Redraw the charts and tables of docs/ from the lines in docs/results/, or add such a line.

python scripts/chart.py                                      every chart and table
python scripts/chart.py relay voice                          some of them
python scripts/chart.py --record call bench call             run a command, append its result
python scripts/chart.py --record faults tests/faults.py --json

Charts are SVG. Charts and tables show the newest line of their file and end with its source: date,
commit and command. A recorded line holds these, the machine and the result as JSON, which is the
last line that the command prints.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs" / "results"
PAGE_COLUMNS = 118
BLUE, ORANGE, YELLOW, GREY = "#0072B2", "#D55E00", "#E69F00", "#777777"
COLOURS = (BLUE, ORANGE, "#009E73", "#CC79A7", YELLOW)
"""Distinct for colour-blind readers, too."""

Line = dict[str, Any]
Row = dict[str, Any]
Column = str | Callable[[Row], object]
"""How a table shows a row: a field's name, a template such as ``{ms:.1f}``, or a function."""

matplotlib.use("svg")
plt.rcParams.update(
    {
        "svg.fonttype": "none",  # text stays text: small files, searchable
        "svg.hashsalt": "pica",  # the same bytes for the same data
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.alpha": 0.3,
        "legend.frameon": False,
        "lines.markersize": 4,
        "figure.constrained_layout.use": True,
    }
)


def read_lines(name: str) -> list[Line]:
    """Return all lines of docs/results/NAME.jsonl, oldest first."""
    return [json.loads(text) for text in (RESULTS / f"{name}.jsonl").read_text().splitlines()]


def source_line(line: Line) -> str:
    """Return what a chart or table says of its data."""
    return f"{line['date']} · commit {line['commit']} · {line['command']}"


def save(figure: Figure, name: str, line: Line, title: str = "") -> None:
    """Write docs/results/NAME.svg, with a title and the source of its data."""
    figure.suptitle(title, fontsize=10)
    figure.supxlabel(source_line(line), fontsize=6, color="#555555")
    path = RESULTS / f"{name}.svg"
    figure.savefig(path, metadata={"Date": None, "Creator": "scripts/chart.py"})
    plt.close(figure)
    # matplotlib leaves blanks at the ends of lines
    path.write_text("\n".join(text.rstrip() for text in path.read_text().splitlines()) + "\n")


def fill_in(page: Path, mark: str, text: str, line: Line) -> None:
    """Replace what stands between ``<!-- MARK -->`` and ``<!-- end MARK -->`` of a page."""
    begin, end = f"<!-- {mark} -->", f"<!-- end {mark} -->"
    before, found, rest = page.read_text().partition(begin)
    _, found_end, after = rest.partition(end)
    if not (found and found_end):
        sys.exit(f"{page.relative_to(ROOT)} has no place for {mark!r}")
    source = textwrap.fill(source_line(line), PAGE_COLUMNS, break_on_hyphens=False)
    page.write_text(f"{before}{begin}\n{text}\n\n{source}\n{end}{after}")


def table(rows: Iterable[Row], columns: Mapping[str, Column]) -> str:
    """Return a Markdown table with columns by their heads; None becomes a dash."""

    def cell(row: Row, column: Column) -> str:
        if callable(column):
            value = column(row)
        else:
            value = column.format_map(row) if "{" in column else row[column]
        return "–" if value is None else str(value)

    lines = [" | ".join(columns), " | ".join("---" for _ in columns)]
    lines += [" | ".join(cell(row, column) for column in columns.values()) for row in rows]
    return "\n".join(f"| {line} |" for line in lines)


def plain_ticks(axis: Axis) -> None:
    """Write the ticks of a logarithmic axis as plain numbers, at 1, 2 and 5."""
    axis.set_major_locator(LogLocator(base=10, subs=(1, 2, 5)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))


def pair(figures: Mapping[str, float | None], names: Sequence[str], digits: int) -> str:
    """Return two percentiles as one cell."""
    return " / ".join("–" if (f := figures[n]) is None else f"{f:.{digits}f}" for n in names)


SERVERS: dict[str, dict[str, Any]] = {
    "relay": {"label": "pica relay", "color": BLUE, "marker": "o"},
    "naive": {"label": "naive, same library", "color": ORANGE, "marker": "s"},
    "naive-uvloop": {"label": "naive, with uvloop", "color": YELLOW, "marker": "^"},
    "echo": {"label": "echo: the generator's limit", "color": GREY, "marker": "."},
}


def chart_relay() -> None:
    """Draw delivered frames, latency and cost against the number of rooms, of the newest commit.

    Of several runs of one load, the one with the median processor time stands for all.
    """
    lines = [line for line in read_lines("relay") if "forward_ms" in line["result"]]
    newest = [line for line in lines if line["commit"] == lines[-1]["commit"]]
    loads = []
    for rooms in sorted({line["result"]["rooms"] for line in newest}):
        runs = [line["result"] for line in newest if line["result"]["rooms"] == rooms]
        runs.sort(key=lambda run: float(run["relay_cpu_s_per_1000"]))
        loads.append({"relay": runs[len(runs) // 2], **runs[len(runs) // 2].get("compare", {})})
    rows = [row | {"server": name} for load in loads for name, row in load.items()]
    figure, axes = plt.subplots(3, 1, figsize=(6.4, 7.6), sharex=True)
    for name, style in SERVERS.items():
        chosen = [row for row in rows if row["server"] == name]
        rooms = [row["rooms"] for row in chosen]
        axes[0].plot(rooms, [row["delivered_per_s"] / 1e3 for row in chosen], **style)
        axes[1].plot(rooms, [row["forward_ms"]["p99"] for row in chosen], **style)
        axes[2].plot(rooms, [row["relay_cpu_s_per_1000"] for row in chosen], **style)
    axes[0].set_ylabel("delivered, 1,000 frames/s")
    axes[0].legend(fontsize=8)
    axes[1].set_yscale("log")
    plain_ticks(axes[1].yaxis)
    axes[1].set_ylabel("forwarding p99, ms")
    axes[2].set_ylabel("processor time for\n1,000 frames delivered, s")
    axes[2].set_ylim(bottom=0)
    axes[2].set_xlabel("rooms of five at 30 frames/s each")
    save(figure, "relay", lines[-1], "One relay process on one core, the load on the other")
    columns: dict[str, Column] = {
        "rooms": lambda row: row["rooms"] if row["server"] == "relay" else "",
        "server": lambda row: SERVERS[row["server"]]["label"],
        "delivered/s": "{delivered_per_s:,.0f}",
        "p50 / p99, ms": lambda row: pair(row["forward_ms"], ("p50", "p99"), 1),
        "missing": "missing",
        "core busy": lambda row: f"{row['relay_cpu_ratio']:.0%}" if row["relay_cpu_ratio"] else "–",
        "s per 1,000": "relay_cpu_s_per_1000",
        "bytes/connection": "bytes_per_connection",
    }
    fill_in(RESULTS / "relay.md", "relay-load", table(rows, columns), lines[-1])


def chart_scene() -> None:
    """Draw what one to five heads cost over one that fills the screen, and the error it leaves."""
    line = read_lines("scene")[-1]
    summary = line["result"]["summary"]
    rows = [row for row in line["result"]["rows"] if row["view"] == "front"]
    figure, (cost, error) = plt.subplots(1, 2, figsize=(7.2, 3.4))
    for distance, colour in zip(sorted({r["distance_cm"] for r in rows}), COLOURS, strict=False):
        for is_scheduled, style in ((True, "-o"), (False, "--x")):
            chosen = [
                row
                for row in rows
                if (row["distance_cm"], row["scheduler"]) == (distance, is_scheduled)
                and not row["budget_ms"]
            ]
            counts = [row["avatars"] for row in chosen]
            ratios = [row["total_ms"] / summary["full_screen_ms"] for row in chosen]
            label = f"{distance:g} cm" if is_scheduled else None
            cost.plot(counts, ratios, style, color=colour, label=label)
            if is_scheduled:
                error.plot(counts, [row["error"] for row in chosen], style, color=colour)
    cost.set_ylabel("cost over one head that fills the screen")
    cost.set_xlabel("talking heads, 25 cm apart\n(dashed: without the scheduler)")
    cost.legend(fontsize=8)
    error.set_ylabel("MSE against full levels, 0–255")
    error.set_xlabel("talking heads, no budget")
    for axis in (cost, error):
        axis.set_ylim(bottom=0)
    save(figure, "scene", line)
    columns: dict[str, Column] = {
        "distance, cm": "{distance_cm:g}",
        "five heads over one that fills the screen": "scheduled_over_full_screen",
        "without the scheduler": "unscheduled_over_full_screen",
        "MSE": "error",
    }
    fill_in(RESULTS / "receiver.md", "scene", table(summary["scenes"], columns), line)


def chart_models() -> None:
    """Draw the error of trained models against what decoding and drawing them costs."""
    line = read_lines("models")[-1]
    models, rows = line["result"]["models"], line["result"]["rows"]
    distances = sorted({row["distance_cm"] for row in rows})
    figure, axes = plt.subplots(1, len(distances), figsize=(3.4 * len(distances), 4), sharey=True)
    for axis, distance in zip(axes, distances, strict=True):
        for number, model in enumerate(models):
            (ms,) = (
                row["total_ms"]
                for row in rows
                if row["distance_cm"] == distance
                and all(row[name] == model[name] for name in ("identity", "variant", "block"))
            )
            error = model["mse"]
            axis.errorbar(
                ms,
                error,
                yerr=[[error - model["mse_low"]], [model["mse_high"] - error]],
                fmt="osD^"[number // len(COLOURS)],
                color=COLOURS[number % len(COLOURS)],
                elinewidth=0.6,
                label=f"{model['variant']} {model['block'] or ''}",
            )
        axis.set_title(f"{distance:g} cm", fontsize=9)
        axis.set_xlabel("decode + draw, ms")
    axes[0].set_ylabel("MSE, 0–255, held-out frames")
    axes[-1].legend(fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5))
    save(figure, "models", line)


FAMILIES = {
    "jitter": "jitter p95, ms",
    "stall": "stall every 2.5 s, ms",
    "retransmit": "TCP segments lost, %",
    "thin": "dropped by the relay, %",
    "rate": "rate of the link, kbit/s",
}
"""Families of network scenarios, and what their axis says; a condition is FAMILY-LEVEL."""


def chart_voice() -> None:
    """Draw intelligibility, delay and skew of a voice under network conditions."""
    line = read_lines("voice")[-1]
    rows = line["result"]["rows"]
    panels: dict[str, Callable[[Row], Any]] = {
        "words: STOI": lambda row: row["stoi"],
        "mouth to ear p95, ms": lambda row: row["mouth_to_ear_ms"]["p95"],
        "|skew| p95, ms": lambda row: row["skew_ms"]["p95"],
    }
    figure, grid = plt.subplots(3, len(FAMILIES), figsize=(12, 7), sharex="col", sharey="row")
    for axes, (label, value) in zip(grid, panels.items(), strict=True):
        axes[0].set_ylabel(label)
        for axis, family in zip(axes, FAMILIES, strict=True):
            named = [(*row["condition"].rsplit("-", 1), value(row)) for row in rows]
            points = sorted((int(level), shown) for name, level, shown in named if name == family)
            axis.plot(*zip(*points, strict=True), "o-", color=BLUE)
    for axis, label in zip(grid[-1], FAMILIES.values(), strict=True):
        axis.set_xlabel(label)
    save(figure, "voice", line)
    columns: dict[str, Column] = {
        "condition": "condition",
        "wire, kbit/s": lambda row: f"{row['wire_bps'] / 1e3:.1f}",
        "PESQ": lambda row: None if row["pesq"] is None else f"{row['pesq']:.2f}",
        "STOI": "{stoi:.3f}",
        "mouth to ear p50 / p95, ms": lambda row: pair(row["mouth_to_ear_ms"], ("p50", "p95"), 0),
        "skew p50 / p95, ms": lambda row: pair(row["skew_ms"], ("p50", "p95"), 0),
        "concealed": "{concealed_ratio:.1%}",
        "CPU, ms/s": "{cpu_ms_per_s:.0f}",
    }
    fill_in(RESULTS / "voice.md", "voice", table(rows, columns), line)


def chart_faults() -> None:
    """Fill in the newest row of each fault."""
    lines = read_lines("faults")
    rows = {row["fault"]: row for line in lines for row in line["result"]["faults"]}
    columns: dict[str, Column] = {
        "fault": "fault",
        "faces alive at the end": "survived",
        "last one back after, s": "back_after_s",
        "longest gap, s": "longest_gap_s",
        "age at the end, ms": "age_ms_at_end",
        "relay closed": lambda row: (
            ", ".join(f"{number} × {code}" for code, number in row["closed"].items()) or "–"
        ),
    }
    fill_in(RESULTS / "faults.md", "faults", table(rows.values(), columns), lines[-1])


CHARTS: dict[str, Callable[[], None]] = {
    function.__name__.removeprefix("chart_"): function
    for function in (
        chart_relay,
        chart_scene,
        chart_models,
        chart_voice,
        chart_faults,
    )
}


def record(name: str, words: Sequence[str]) -> None:
    """Run `pica` or a script, and append the result to docs/results/NAME.jsonl."""
    is_script = words[0].endswith(".py")
    command = [*words] if is_script else ["-m", "pica_command", *words, "--json"]
    load_before = os.getloadavg()[0]
    run = subprocess.run([sys.executable, *command], stdout=subprocess.PIPE, text=True)
    if run.returncode:
        sys.exit(run.returncode)
    row = {
        "date": datetime.date.today().isoformat(),
        "commit": git("rev-parse", "--short", "HEAD") + ("+changes" if git("diff", "HEAD") else ""),
        "command": " ".join(words if is_script else ("pica", *words)),
        "machine": {
            "processor": platform.processor() or platform.machine(),
            "cores": os.cpu_count(),
            "system": platform.system(),
            "python": platform.python_version(),
            "load_before": load_before,
        },
        "result": json.loads(run.stdout.splitlines()[-1]),
    }
    with (RESULTS / f"{name}.jsonl").open("a") as file:
        file.write(json.dumps(row) + "\n")


def git(*words: str) -> str:
    """Return what git answers, without the newline."""
    command = ["git", "-C", str(ROOT), *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def main() -> None:
    """Draw what is named, or all; or record a result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help=f"some of {', '.join(CHARTS)}")
    parser.add_argument("--record", nargs=argparse.REMAINDER, metavar="NAME COMMAND")
    options = parser.parse_args()
    if options.record:
        return record(options.record[0], options.record[1:])
    for name in options.names or CHARTS:
        if name not in CHARTS:
            parser.error(f"chart {name!r} is unknown; known are {', '.join(CHARTS)}")
        CHARTS[name]()


if __name__ == "__main__":
    main()
