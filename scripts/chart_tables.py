"""The paper's tables on captures of ours, from recorded evaluations."""

from __future__ import annotations

from charting import RESULTS, Line, fill_in, read_lines, source_line

from pica_core.train.eval_tables import report

PAGE = RESULTS / "tables.md"


def chart_tables() -> None:
    """The newest line of each table."""
    newest: dict[int, Line] = {line["result"]["table"]: line for line in read_lines("tables")}
    for number, line in sorted(newest.items()):
        text = report(number, line["result"]).replace("# Table", "## Table", 1)
        text = text.replace("\n## ", "\n### ")
        machine = line["machine"]
        source = f"{source_line(line)} · {machine['processor']}, Python {machine['python']}"
        fill_in(PAGE, f"table {number}", f"{text.strip()}\n\n`{source}`")
