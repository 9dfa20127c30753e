"""The table of what faults do to a call."""

from __future__ import annotations

from charting import RESULTS, fill_in, read_lines, source_line, table

PAGE = RESULTS / "faults.md"


def chart_faults() -> None:
    """Show the newest row of each fault, and of the newest run when and with what it was made."""
    lines = read_lines("faults")
    if not lines:
        return
    rows = {row["fault"]: row for line in lines for row in line["result"]["faults"]}
    text = table(
        rows.values(),
        {
            "fault": "fault",
            "faces alive at the end": "survived",
            "last one back after, s": "back_after_s",
            "longest still, s": "longest_gap_s",
            "age at the end, ms": "age_ms_at_end",
            "relay closed": lambda row: (
                ", ".join(f"{number} × {code}" for code, number in row["closed"].items()) or "–"
            ),
        },
    )
    fill_in(PAGE, "faults", f"{text}\n\n{source_line(lines[-1])}")
