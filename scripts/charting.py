"""What all charts share: reading recorded lines, writing figures and filling tables into pages."""

from __future__ import annotations

import json
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
LIMITS_PAGE = ROOT / "docs" / "limits-of-the-stream.md"

PAGE_COLUMNS = 118
"""Longest line of prose that is filled into docs/, which allows 120."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
"""Told apart by people who see fewer colours, too."""

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


def finish(figure: Figure, source: Line | str, title: str = "", size: float = 7) -> Figure:
    """Write a title above a figure, and where its data come from below it."""
    if title:
        figure.suptitle(title, fontsize=10)
    text = source if isinstance(source, str) else source_line(source)
    figure.supxlabel(text, fontsize=size, color="#555555")
    return figure


Column = str | Callable[[Row], object]
"""How a table shows a row: a field's name, a template such as ``{ms:.1f}``, or a function."""


def table(rows: Iterable[Row], columns: Mapping[str, Column]) -> str:
    """A table of rows, with its columns by their heads; None becomes a dash."""

    def cell(row: Row, column: Column) -> object:
        if callable(column):
            return column(row)
        return column.format_map(row) if "{" in column else row[column]

    cells = ([cell(row, column) for column in columns.values()] for row in rows)
    return markdown_table(list(columns), cells)


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
    page.write_text(f"{before}{begin}\n{_wrapped(text)}\n{end}{after}")
    print(f"filled {mark} into {page.relative_to(ROOT)}")


def _wrapped(text: str) -> str:
    """The text with paragraphs that fit a page; tables and code stay as they are."""
    return "\n".join(
        line
        if line.startswith(("|", "`")) or len(line) <= PAGE_COLUMNS
        else textwrap.fill(line, PAGE_COLUMNS, break_long_words=False, break_on_hyphens=False)
        for line in text.splitlines()
    )


def short_source(source: str) -> str:
    """A source's name without folder and ending."""
    kind, _, name = source.partition(":")
    stem = Path(name).stem.replace("_", "-")
    return f"recording-{stem}" if kind == "csv" else stem


def rows_where(rows: Iterable[Row], **wanted: object) -> list[Row]:
    """The rows whose fields have these values."""
    return [row for row in rows if all(row[name] == value for name, value in wanted.items())]


def values(rows: Iterable[Row], field: str) -> list[Any]:
    """A field of all rows."""
    return [row[field] for row in rows]


def plain_ticks(axis: Axis) -> None:
    """Write the ticks of a logarithmic axis as plain numbers, at 1, 2 and 5."""
    axis.set_major_locator(LogLocator(base=10, subs=(1, 2, 5)))
    axis.set_minor_locator(NullLocator())
    number_ticks(axis)


def number_ticks(axis: Axis) -> None:
    """Write the ticks of an axis as plain numbers."""
    axis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
