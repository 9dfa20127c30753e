"""Charts of `pica bench codec`: bitrate against the error of the rendered face."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
from charting import (
    LIMITS_PAGE,
    RESULTS,
    Column,
    Line,
    Row,
    fill_in,
    finish,
    plain_ticks,
    read_lines,
    save,
    short_source,
    source_line,
    table,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure

PAGE = RESULTS / "codec.md"
STYLES: tuple[tuple[str, dict[str, Any]], ...] = (
    ("quality-", {"color": "#0072B2", "marker": "o", "label": "ours, qualities 0 to 7"}),
    (
        "thinned",
        {
            "color": "#56B4E9",
            "marker": "v",
            "linestyle": ":",
            "label": "ours thinned to 15, 7.5 fps",
        },
    ),
    (
        "rate-",
        {"color": "#009E73", "marker": "s", "linestyle": "--", "label": "ours kept to a bitrate"},
    ),
    ("plain-8-bit", {"color": "#D55E00", "marker": "D", "label": "plain 8 bit"}),
    ("float-16", {"color": "#CC79A7", "marker": "P", "label": "16-bit float"}),
    ("zlib", {"color": "#E69F00", "marker": "<", "label": "8 bit, zlib"}),
    ("zstd", {"color": "#777777", "marker": ">", "label": "8 bit, zstd with dictionary"}),
)
FIGURES = (
    ("mse", "rendered MSE, 0–255,\nagainst the uncoded face"),
    ("change_mse", "MSE of the change\nto the next frame"),
    ("psnr_loss_db", "PSNR loss against\nthe head itself, dB"),
)


def _family(profile: str) -> str:
    if "-layer-" in profile:
        return "thinned"
    return next(name for name, _ in STYLES if profile.startswith(name))


def chart_codec() -> None:
    """The newest run of each avatar, and a table of all their rows."""
    newest = {line["result"]["avatar"]: line for line in read_lines("codec")}
    parts = []
    for avatar, line in sorted(newest.items()):
        save(_draw(line), f"codec-{avatar.lower()}")
        parts.append(f"### {avatar}\n\n{_table(line)}\n\n{source_line(line)}")
    if parts:
        fill_in(PAGE, "codec", "\n\n".join(parts))
        fill_in(LIMITS_PAGE, "codec", "\n\n".join(map(_verdicts, newest.values())))


def _verdicts(line: Line) -> str:
    """How good the face is at each kept bitrate, by the error of the worst moment."""

    def grade(row: Row) -> str:
        worst = row["worst_frame_mse"]
        return "good" if worst <= 16 else "usable" if worst <= 32 else "**broken**"

    columns: dict[str, Column] = {
        "avatar, source": lambda row: f"{line['result']['avatar']}, {short_source(row['source'])}",
        "told to keep": lambda row: f"{int(row['profile'].removeprefix('rate-')) / 1e3:g} kbit/s",
        "sent": lambda row: f"{row['payload_bps'] / 1e3:.2f} kbit/s",
        "frames a second": "{frames_per_s:.0f}",
        "MSE": "{mse:.1f}",
        "worst": "{worst_frame_mse:.0f}",
        "verdict": grade,
    }
    rows = [row for row in line["result"]["rows"] if row["profile"].startswith("rate-")]
    return f"{table(rows, columns)}\n\n{source_line(line)}"


def _draw(line: Line) -> Figure:
    rows: list[Row] = line["result"]["rows"]
    sources = list(dict.fromkeys(row["source"] for row in rows))
    figure, grid = plt.subplots(
        len(FIGURES),
        len(sources),
        figsize=(3.4 * len(sources) + 2.2, 8.2),
        sharex=True,
        sharey="row",
        squeeze=False,
        layout="constrained",
    )
    for column, source in enumerate(sources):
        chosen = [row for row in rows if row["source"] == source]
        for axes, (figure_name, _) in zip(grid, FIGURES, strict=True):
            _draw_profiles(axes[column], chosen, figure_name)
        grid[0][column].set_title(short_source(source), fontsize=9)
        grid[-1][column].set_xlabel("payload, kbit/s")
    for axes, (name, label) in zip(grid, FIGURES, strict=True):
        axes[0].set_ylabel(label)
        axes[0].set_xscale("log")
        plain_ticks(axes[0].xaxis)
        if name == "psnr_loss_db":
            axes[0].set_yscale("symlog", linthresh=0.1)
            axes[0].set_yticks([0, 0.1, 0.3, 1, 3], ["0", "0.1", "0.3", "1", "3"])
            axes[0].minorticks_off()
            for axis in axes:
                axis.axhline(0.1, color="black", linewidth=0.8)
        else:
            axes[0].set_yscale("log")
            plain_ticks(axes[0].yaxis)
        for axis in axes:
            axis.axvline(2, color="black", linewidth=0.8, linestyle=":")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False)
    return finish(
        figure,
        line,
        f"Bits against the rendered face, 30 fps, head pose included; synthetic avatar "
        f"{line['result']['avatar']}; lines at 2 kbit/s and 0.1 dB",
    )


def _draw_profiles(axis: Axes, rows: Sequence[Row], figure: str) -> None:
    for family, style in STYLES:
        points = [
            (row["payload_bps"] / 1e3, row[figure])
            for row in rows
            if _family(row["profile"]) == family and row[figure] is not None
        ]
        if figure != "psnr_loss_db":
            points = [(bits, max(error, 0.02)) for bits, error in points]
        points.sort()
        axis.plot([bits for bits, _ in points], [error for _, error in points], **style)


def _table(line: Line) -> str:
    rows: list[Row] = line["result"]["rows"]
    firsts = {row["source"]: row["profile"] for row in reversed(rows)}

    def decibels(field: str, digits: int) -> Column:
        return lambda row: None if row[field] is None else f"{row[field]:+.{digits}f}"

    columns: dict[str, Column] = {
        "source": lambda row: (
            short_source(row["source"]) if firsts[row["source"]] == row["profile"] else ""
        ),
        "profile": "profile",
        "payload, kbit/s": lambda row: f"{row['payload_bps'] / 1e3:.2f}",
        "wire, kbit/s": lambda row: f"{row['wire_bps'] / 1e3:.1f}",
        "MSE": "{mse:.2f}",
        "worst frame": "{worst_frame_mse:.1f}",
        "change MSE": "{change_mse:.2f}",
        "PSNR loss, dB": decibels("psnr_loss_db", 3),
        "worst frame, dB": decibels("worst_frame_loss_db", 2),
        "pose, mrad / mm": "{pose_mrad:.2f} / {pose_mm:.3f}",
        "encode + decode, µs": "{encode_us:.0f} + {decode_us:.0f}",
    }
    return table(rows, columns)
