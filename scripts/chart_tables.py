"""The paper's tables on captures of ours, from recorded evaluations."""

from __future__ import annotations

from typing import Any

from charting import RESULTS, Line, fill_in, read_lines, source_line

from pica_core.train.eval.tables import TABLES, report

PAGE = RESULTS / "tables.md"


def chart_tables() -> None:
    """The newest evaluation of each run, in each table."""
    lines = read_lines("tables")
    for number in TABLES:
        own = [line for line in lines if line["result"]["table"] == number]
        if not own:
            continue
        used, result = merge(own)
        text = report(number, result).replace("# Table", "## Table", 1)
        text = text.replace("\n## ", "\n### ").strip()
        sources = "\n\n".join(f"`{source_line(line)} · {_machine(line)}`" for line in used)
        fill_in(PAGE, f"table {number}", f"{text}\n\n{sources}")


def merge(lines: list[Line]) -> tuple[list[Line], dict[str, Any]]:
    """Evaluations of several runs as one; of one identity, model and seed the newest counts.

    Returns:
        The lines that something was taken of, and the whole.
    """
    newest = {_run(run): line for line in lines for run in line["result"]["runs"]}
    whole: dict[str, Any] = {"rows": [], "runs": [], "tracked_mesh": {}}
    for line in lines:
        result = line["result"]
        for part in ("rows", "runs"):
            whole[part] += [each for each in result[part] if newest[_run(each)] is line]
        whole["tracked_mesh"] |= {who: mm for who, mm in result["tracked_mesh"].items() if mm}
    return [line for line in lines if line in newest.values()], whole


def _run(row: dict[str, Any]) -> tuple[str, str, int]:
    return row["identity"], row["variant"], row["seed"]


def _machine(line: Line) -> str:
    machine = line["machine"]
    return f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}"
