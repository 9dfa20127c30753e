"""Tables of `pica bench drive`, and of how long a tracker's sample takes to the wire."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from charting import RESULTS, Row, fill_in, read_lines, short_source, source_line, table

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
STILL = "still:"


def chart_drive() -> None:
    """Means of each row's newest run: by avatar, by step and source, and for calibration."""
    lines = read_lines("drive")
    if lines:
        newest = {
            tuple(row[name] for name in ("avatar", "source", "stage", "level")): row
            for line in lines
            for row in line["result"]["rows"]
        }
        rows: list[Row] = list(newest.values())
        webcam = _of(rows, "webcam")
        moving = [row for row in rows if not row["source"].startswith(STILL)]
        moving = [row for row in moving if row["stage"] != "webcam"]
        still = [row for row in rows if row["source"].startswith(STILL)]
        coded = [row for row in moving if row["stage"] == "codec"]
        parts = {
            "drive-avatars": table(_means(coded, ("avatar", "level")), _columns("avatar", "level")),
            "drive-stages": table(
                _means(moving, ("source", "stage", "level")), _columns("source", "stage", "level")
            ),
            "drive-webcam": table(webcam, _columns("avatar", "source", "level")),
            "drive-calibration": table(
                _means(_of(still, "driver", "offset", "calibrated"), ("source", "stage", "level")),
                _columns("source", "stage", "level"),
            ),
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


def _columns(*by: str) -> dict[str, object]:
    shown = {"source": lambda row: short_source(row["source"])}
    return {name: shown.get(name, name) for name in by} | COLUMNS
