"""Tables of `pica bench drive`, and of how long a tracker's sample takes to the wire."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from charting import RESULTS, Column, Row, fill_in, read_lines, short_source, source_line, table

PAGE = RESULTS / "drive.md"
FIGURES = ("mse", "p95_mse", "lid_mm", "lip_mm", "poke_ratio", "p95_poke_ratio")
COLUMNS = {
    "MSE": "{mse:.1f}",
    "p95": "{p95_mse:.1f}",
    "lids, mm": "{lid_mm:.2f}",
    "lips, mm": "{lip_mm:.2f}",
    "poke": "{poke_ratio:.3%}",
    "poke, p95": "{p95_poke_ratio:.3%}",
}
MOST = {"poke, most": "{most_poke_ratio:.3%}"}
STILL, RECORDED = "still:", "csv:"


def chart_drive() -> None:
    """Each row's newest run: recordings by avatar, and means by step and source and at rest."""
    lines = read_lines("drive")
    if lines:
        newest = {
            tuple(row[name] for name in ("avatar", "source", "stage", "level")): row
            for line in lines
            for row in line["result"]["rows"]
        }
        rows: list[Row] = list(newest.values())
        still = [row for row in rows if row["source"].startswith(STILL)]
        moving = [row for row in rows if row["stage"] != "webcam" and row not in still]
        recorded = [row for row in moving if row["source"].startswith(RECORDED)]
        acted = [row for row in moving if row not in recorded]
        by = ("source", "stage", "level")
        parts = {
            "drive-avatars": table(recorded, _columns("avatar", "level") | MOST),
            "drive-stages": table(_means(acted, by), _columns(*by)),
            "drive-webcam": table(_of(rows, "webcam"), _columns("avatar", "source", "level")),
            "drive-calibration": table(_means(still, by), _columns(*by)),
        }
        for mark, text in parts.items():
            fill_in(PAGE, mark, text)
        commands = dict.fromkeys(source_line(line) for line in lines)
        fill_in(PAGE, "drive-commands", "```text\n" + "\n".join(commands) + "\n```")
    if latency := read_lines("live"):
        line = latency[-1]
        columns = {"protocol": "protocol", "frames": "frames"}
        columns |= {
            f"{words}, ms p50 / p99": f"{{{name}_ms[p50]}} / {{{name}_ms[p99]}}"
            for name, words in (
                ("take", "arrival to sample"),
                ("send", "due to sent"),
                ("path", "both"),
                ("wait", "waits between"),
            )
        }
        smoothing = {
            "what moves": "movement",
            "by": "sizes",
            "delay, ms": "{delay_ms[0]:g} / {delay_ms[1]:g}",
        }
        fill_in(PAGE, "smoothing", table(line["result"]["smoothing"], smoothing))
        fill_in(PAGE, "live", f"{table(line['result']['rows'], columns)}\n\n{source_line(line)}")


def _of(rows: Iterable[Row], *stages: str) -> list[Row]:
    return [row for row in rows if row["stage"] in stages]


def _means(rows: Iterable[Row], by: Sequence[str]) -> list[Row]:
    """Means of all figures over the rows that agree in some fields, in the order of the rows."""
    groups: dict[tuple[object, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in by), []).append(row)
    return [
        dict(zip(by, key, strict=True))
        | {name: float(np.mean([row[name] for row in group])) for name in FIGURES}
        for key, group in groups.items()
    ]


def _columns(*by: str) -> dict[str, Column]:
    shown: dict[str, Column] = {"source": lambda row: short_source(row["source"])}
    return {name: shown.get(name, name) for name in by} | COLUMNS
