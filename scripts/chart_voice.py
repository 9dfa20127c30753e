"""Charts of `pica bench voice`: what arrives of a voice, and of its step with the face."""

from __future__ import annotations

import matplotlib.pyplot as plt
from chart_playout import FAMILIES
from charting import (
    RESULTS,
    Column,
    Line,
    Row,
    fill_in,
    finish,
    read_lines,
    save,
    source_line,
    table,
)
from matplotlib.figure import Figure

VOICE_PAGE = RESULTS / "voice.md"
INTELLIGIBLE_STOI = 0.75
"""Below it words are lost (chosen: docs/results/voice.md)."""


def chart_voice() -> None:
    """Intelligibility, delay and step under every trouble, and all figures as a table."""
    line = read_lines("voice")[-1]
    save(_draw(line), "voice")
    fill_in(VOICE_PAGE, "voice", f"{_table(line)}\n\n{source_line(line)}")


def _draw(line: Line) -> Figure:
    rows: list[Row] = line["result"]["rows"]
    calm = next(row for row in rows if row["condition"] == "jitter-0")
    figure, grid = plt.subplots(
        3, len(FAMILIES), figsize=(15, 7.4), sharex="col", sharey="row", layout="constrained"
    )
    for column, (family, label, unit) in enumerate(FAMILIES):
        points = [(_level(row), row) for row in rows if _family(row) == family]
        if family not in ("jitter", "rate"):
            points.append((0, calm))
        points.sort(key=lambda point: point[0])
        levels = [level for level, _ in points]
        words, age, step = grid[:, column]
        words.plot(levels, [row["stoi"] for _, row in points], "o-", color="#0072B2", label="STOI")
        held = [1 - row["face_held_ratio"] for _, row in points]
        words.plot(levels, held, "s--", color="#E69F00", label="share of time with a moving face")
        words.axhline(INTELLIGIBLE_STOI, color="black", linewidth=0.8)
        for share, style in (("p50", "o-"), ("p95", "^:")):
            ages = [row["mouth_to_ear_ms"][share] for _, row in points]
            age.plot(levels, ages, style, color="#0072B2", label=f"mouth to ear, {share}")
        early = [max(-row["skew_ms"]["earliest"], 0.0) for _, row in points]
        step.plot(
            levels,
            [row["skew_ms"]["p95"] for _, row in points],
            "o-",
            color="#0072B2",
            label="|skew|, p95",
        )
        step.plot(levels, early, "^:", color="#D55E00", label="sound early, worst")
        step.axhline(45, color="black", linewidth=0.8)
        if family == "rate":
            step.set_xscale("log", base=2)
            step.invert_xaxis()
            step.set_xticks(levels, map(str, levels))
            step.minorticks_off()
        step.set_xlabel(f"{label}, {unit}")
    grid[0][0].set_ylabel("words: STOI;\nface: share of time")
    grid[0][0].set_ylim(0, 1.05)
    grid[1][0].set_ylabel("ms")
    grid[1][0].set_yscale("log")
    grid[2][0].set_ylabel("ms")
    grid[2][0].set_ylim(0, 60)
    for row in grid:
        handles, labels = row[0].get_legend_handles_labels()
        row[-1].legend(handles, labels, fontsize=7, frameon=False)
    return finish(
        figure,
        line,
        "A voice and its face in the troubled third of a run: Opus at "
        f"{calm['kbps']} kbit/s, synthetic speech, {line['result']['source']}",
    )


def _family(row: Row) -> str:
    return str(row["condition"]).rpartition("-")[0]


def _level(row: Row) -> int:
    return int(str(row["condition"]).rpartition("-")[2])


def _table(line: Line) -> str:
    columns: dict[str, Column] = {
        "trouble": "condition",
        "kbit/s": "kbps",
        "wire, kbit/s": lambda row: f"{row['wire_bps'] / 1e3:.1f}",
        "PESQ": lambda row: "–" if row["pesq"] is None else f"{row['pesq']:.2f}",
        "STOI": "{stoi:.3f}",
        "mouth to ear p50 / p95, ms": lambda row: _pair(row["mouth_to_ear_ms"]),
        "skew p50 / p95, ms": lambda row: _pair(row["skew_ms"]),
        "worst, ms": lambda row: f"{row['skew_ms']['worst']:+.0f}",
        "earliest, ms": lambda row: f"{row['skew_ms']['earliest']:+.0f}",
        "p95, lips held": lambda row: _ms(row.get("still_skew_ms", {}).get("p95")),
        "face held": "{face_held_ratio:.1%}",
        "concealed": "{concealed_ratio:.1%}",
        "stretched": "{stretched_ratio:.1%}",
        "sound back, ms": lambda row: _ms(row["recovery_ms"]),
        "delay back, ms": lambda row: _ms(row["delay_recovery_ms"]),
        "CPU, ms/s": "{cpu_ms_per_s:.0f}",
    }
    return table(line["result"]["rows"], columns)


def _pair(figures: dict[str, float | None]) -> str:
    return " / ".join(_ms(figures[share]) for share in ("p50", "p95"))


def _ms(value: float | None) -> str:
    return "–" if value is None else f"{value:.0f}"
