"""Redraw the charts and tables of docs/results.md from docs/results/*.jsonl, or add such a line.

python scripts/chart.py                                      every chart and table
python scripts/chart.py relay voice                          some of them
python scripts/chart.py --record call bench call             run a command, append its result

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
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import mean, median
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs" / "results"
PAGE = ROOT / "docs" / "results.md"
PAGE_COLUMNS = 118
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
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


def save(figure: Figure, name: str, line: Line) -> None:
    """Write docs/results/NAME.svg, with the source of its data."""
    figure.supxlabel(source_line(line), fontsize=6, color="#555555")
    path = RESULTS / f"{name}.svg"
    figure.savefig(path, metadata={"Date": None, "Creator": "scripts/chart.py"})
    plt.close(figure)
    # matplotlib leaves blanks at the ends of lines
    path.write_text("\n".join(text.rstrip() for text in path.read_text().splitlines()) + "\n")


def fill_in(mark: str, text: str, source: str) -> None:
    """Replace what stands between ``<!-- MARK -->`` and ``<!-- end MARK -->`` of the page."""
    begin, end = f"<!-- {mark} -->", f"<!-- end {mark} -->"
    before, found, rest = PAGE.read_text().partition(begin)
    _, found_end, after = rest.partition(end)
    if not (found and found_end):
        sys.exit(f"{PAGE.relative_to(ROOT)} has no place for {mark!r}")
    source = textwrap.fill(source, PAGE_COLUMNS, break_on_hyphens=False)
    PAGE.write_text(f"{before}{begin}\n{text}\n\n{source}\n{end}{after}")


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


def joined(figures: Mapping[str, float | None], names: Sequence[str], digits: int) -> str:
    """Return some figures as one cell."""
    return "/".join("–" if (f := figures[n]) is None else f"{f:.{digits}f}" for n in names)


def newest_fence() -> dict[str, Line]:
    """Return the newest line of each row of the fence."""
    return {line["row"]: line for line in read_lines("fence")}


def shown(value: float) -> str:
    """Return a figure with four digits."""
    return f"{value:,.0f}" if value >= 1e4 else f"{value:.4g}"


def chart_fence() -> None:
    """Fill in the newest figures of calls, decoding and drawing."""
    lines = newest_fence()
    rows = [
        {
            "row": name,
            "commit": line["commit"],
            "figures": ", ".join(
                f"{figure.replace('_', ' ')} {shown(values[0])}"
                for figure, values in line["figures"].items()
            ),
        }
        for name, line in lines.items()
        if name.split()[0] in ("call", "demo", "decode", "scene")
    ]
    dates = sorted({line["date"] for line in lines.values()})
    columns = {name: name for name in ("row", "figures", "commit")}
    fill_in("fence", table(rows, columns), f"{dates[-1]} · python scripts/fence.py")


def chart_faults() -> None:
    """Fill in after how many seconds all faces are back, for each fault."""
    line = newest_fence()["faults"]
    rows = [
        {"fault": name.removesuffix(": back_after_s"), "seconds": f"{values[0]:.1f}"}
        for name, values in line["figures"].items()
        if name.endswith("back_after_s")
    ]
    source = f"{line['date']} · commit {line['commit']} · python tests/faults.py"
    fill_in("faults", table(rows, {"fault": "fault", "back after, s": "seconds"}), source)


def chart_relay() -> None:
    """Fill in delivered frames, latency and cost by the number of rooms, of the newest commit.

    Of several runs of one load, the one with the median processor time stands for all.
    """
    lines = read_lines("relay")
    newest = [line["result"] for line in lines if line["commit"] == lines[-1]["commit"]]
    loads = []
    for rooms in sorted({result["rooms"] for result in newest}):
        runs = [result for result in newest if result["rooms"] == rooms]
        runs.sort(key=lambda run: float(run["relay_cpu_s_per_1000"]))
        loads.append({"relay": runs[len(runs) // 2], **runs[len(runs) // 2].get("compare", {})})
    rows = [row | {"server": name} for load in loads for name, row in load.items()]
    columns: dict[str, Column] = {
        "rooms": "rooms",
        "server": lambda row: {"relay": "pica relay", "naive": "naive"}[row["server"]],
        "delivered/s": "{delivered_per_s:,.0f}",
        "p50/p99, ms": lambda row: joined(row["forward_ms"], ("p50", "p99"), 1),
        "missing": "missing",
        "core busy": lambda row: f"{row['relay_cpu_ratio']:.0%}",
        "s per 1,000": "relay_cpu_s_per_1000",
        "bytes/connection": "bytes_per_connection",
    }
    fill_in("relay", table(rows, columns), source_line(lines[-1]))


def chart_scene() -> None:
    """Draw what one to five heads cost over one that fills the screen, and what error is left."""
    line = read_lines("scene")[-1]
    rows = line["result"]["rows"]
    full_ms = rows[0]["cpu_ms"]  # one head that fills the screen, decoded whole
    rows = [row for row in rows[2:] if row["budget_ms"] is None]
    figure, (cost, error) = plt.subplots(1, 2, figsize=(8.4, 3.4))
    lines: dict[tuple[float, bool], list[Row]] = defaultdict(list)
    for row in rows:
        lines[row["distance_cm"], row["scheduler"]].append(row)
    colours = dict(zip(sorted({distance for distance, _ in lines}), COLOURS, strict=False))
    for (distance, is_scheduled), chosen in lines.items():
        counts = [row["avatars"] for row in chosen]
        style, label = ("-o", f"{distance:g} cm") if is_scheduled else ("--x", None)
        ratios = [row["cpu_ms"] / full_ms for row in chosen]
        cost.plot(counts, ratios, style, color=colours[distance], label=label)
        if is_scheduled:
            error.plot(counts, [row["error"] for row in chosen], style, color=colours[distance])
    cost.set_ylabel("processor time over one\nhead that fills the screen")
    cost.set_xlabel("talking heads, 25 cm apart\n(dashed: without the scheduler)")
    cost.legend(fontsize=8)
    error.set(xlabel="talking heads", ylabel="MSE against full levels, 0–255")
    for axis in (cost, error):
        axis.set_ylim(bottom=0)
    save(figure, "scene", line)


def fill_rows(name: str) -> None:
    """Fill in the rows of the newest line as they are."""
    line = read_lines(name)[-1]
    fill_in(name, table(line["result"]["rows"], ROWS[name]), source_line(line))


def chart_drive() -> None:
    """Fill in each avatar as a real recording drives it, its levels side by side."""
    lines = read_lines("drive")
    levels: dict[str, list[Row]] = defaultdict(list)
    for line in lines:
        for row in line["result"]["rows"]:
            if row["source"].startswith("csv:"):
                levels[row["avatar"]].append(row)

    def cell(key: str, form: str) -> Column:
        return lambda row: " / ".join(form.format(level[key]) for level in row["levels"])

    columns: dict[str, Column] = {
        "avatar": "avatar",
        "MSE at 64 / 128 / 256": cell("mse", "{:.1f}"),
        "lids, mm": lambda row: f"{row['levels'][-1]['lid_mm']:.2f}",
        "lips, mm": lambda row: f"{row['levels'][-1]['lip_mm']:.2f}",
    }
    rows = [{"avatar": avatar, "levels": each} for avatar, each in levels.items()]
    fill_in("drive", table(rows, columns), source_line(lines[-1]))


def chart_codec() -> None:
    """Draw the error of a driven face against the rate on the wire: qualities along a curve, a
    curve for each level of detail."""
    lines = read_lines("codec")
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.0))
    curves: dict[tuple[str, int], list[Row]] = defaultdict(list)
    for row in (row for line in lines for row in line["result"]["rows"]):
        curves[row["source"], row["level"]].append(row)
    for axis, source in zip(axes, dict.fromkeys(source for source, _ in curves), strict=True):
        for level, colour in zip((64, 128, 256), COLOURS, strict=False):
            rows = curves[source, level]
            rates, errors = ([row[key] for row in rows] for key in ("wire_bps", "mse"))
            axis.plot([rate / 1000 for rate in rates], errors, "-o", color=colour, label=level)
        axis.set(title=source.partition(":")[2], xlabel="kbit/s on the wire", ylim=0)
    axes[0].set_ylabel("MSE against the person, 0–255")
    axes[1].legend(title="level", fontsize=8)
    save(figure, "codec", lines[-1])


def chart_paper() -> None:
    """Draw held-out errors of models against the steps and the seconds of their training."""
    line = read_lines("paper")[-1]
    figure, axes = plt.subplots(1, 3, figsize=(10.2, 3.0))
    shown = (("joint steps", "MSE"), ("seconds", "MSE"), ("joint steps", "vertices off, mm"))
    for axis, (along, error) in zip(axes, shown, strict=True):
        for (model, curve), colour in zip(line["result"]["curves"].items(), COLOURS, strict=False):
            points = [[point[key] for point in curve] for key in (along, error)]
            axis.plot(*points, "-o", color=colour, label=model)
        axis.set(xlabel=along, ylabel=error, ylim=0)
    axes[0].legend(fontsize=8)
    save(figure, "paper", line)


def chart_tables() -> None:
    """Fill in the paper's tables: of each person the front view and the mean of five."""
    line = read_lines("tables")[-1]
    found: dict[str, list[Row]] = defaultdict(list)
    for row in line["result"]["rows"]:
        found[row["variant"]].append(row)
    people = list(dict.fromkeys(row["identity"] for row in line["result"]["rows"]))
    rows: list[Row] = []
    for variant, each in found.items():
        rows.append({"model": variant, "size": each[0]["parameters"] / 1e6})
        for person in people:
            own = {row["view"]: row["mse"] for row in each if row["identity"] == person}
            rows[-1][person] = f"{own['front']:.1f} / {mean(own.values()):.1f}"
    columns: dict[str, Column] = {"model": "model"}
    columns |= {f"{person.title()}: front / five views": person for person in people}
    columns["M parameters"] = "{size:.2f}"
    fill_in("tables", table(rows, columns), source_line(line))


def chart_failures() -> None:
    """Fill in what models do of spoilt captures: medians over seeds, the lowest and the highest."""
    line = read_lines("failures")[-1]
    found: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in line["result"]["rows"]:
        found[row["condition"]][row["model"]].append(row["mse"])
        if row["condition"] == "right data":
            found["near views"][row["model"]].append(row["near"])
            found["6 σ: mm moved"][row["model"]].append(row["moved_mm"])

    def cell(model: str) -> Column:
        def shown(row: Row) -> str | None:
            if values := row["models"].get(model):
                return "/".join(f"{each(values):.0f}" for each in (min, median, max))
            return None

        return shown

    rows = [{"condition": name, "models": each} for name, each in found.items()]
    columns: dict[str, Column] = {"condition": "condition"}
    columns |= {model: cell(model) for model in ("full", "baseline", "linear")}
    fill_in("failures", table(rows, columns), source_line(line))


ROWS: dict[str, dict[str, Column]] = {
    "voice": {
        "condition": "condition",
        "PESQ": lambda row: None if row["pesq"] is None else f"{row['pesq']:.2f}",
        "mouth to ear p50/p95, ms": lambda row: joined(row["mouth_to_ear_ms"], ("p50", "p95"), 0),
        "skew p95, ms": lambda row: f"{row['skew_ms']['p95']:.0f}",
        "concealed": "{concealed_ratio:.1%}",
        "face: MSE": lambda row: f"{row['face_mse']:.1f}",
        "still, ms": "{face_still_ms:.0f}",
    },
}
"""Tables of rows as they were recorded."""
CHARTS: dict[str, Callable[[], None]] = {name: partial(fill_rows, name) for name in ROWS}
CHARTS |= {
    name.removeprefix("chart_"): function
    for name, function in list(globals().items())
    if name.startswith("chart_")
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
