"""Error against cost of trained models: the rows of the paper's tables, and blocks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import matplotlib.pyplot as plt
from charting import (
    COLOURS,
    ROOT,
    Column,
    Line,
    Row,
    fill_in,
    finish,
    plain_ticks,
    read_lines,
    save,
    source_line,
    table,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

PAGE = ROOT / "docs" / "variants.md"
MAIN_CM = 65.0
"""The paper's middle distance."""
MAX_COMMAND = 90
"""Longer commands are not written under a chart; the recorded line has them."""
WIDE = 4.0
"""From this ratio of the largest to the smallest value an axis is logarithmic (chosen)."""
LABEL_SIZE = 6.5

Box = tuple[float, float, float, float]
"""Left, bottom, right, top, pixels."""


def chart_models() -> None:
    """The newest line."""
    if lines := read_lines("models"):
        save(_draw(lines[-1]), "models")
        text = "![error against decode and draw time](results/models.svg)"
        fill_in(PAGE, "models", f"{text}\n\n{_table(lines[-1])}")


def _draw(line: Line) -> Figure:
    result = line["result"]
    distances = sorted({row["distance_cm"] for row in result["rows"]})
    main = min(distances, key=lambda cm: abs(cm - MAIN_CM))
    # Far off decoding is most of the cost, near by drawing is: the second panel shows the other.
    shown = list(dict.fromkeys((main, distances[0])))
    people = list(dict.fromkeys(row["identity"] for row in result["rows"]))
    figure, axes = plt.subplots(
        1, len(shown), figsize=(4.6 * len(shown), 4.4), sharey=True, layout="constrained"
    )
    panels = list(axes.flat) if len(shown) > 1 else [axes]
    for axis, distance in zip(panels, shown, strict=True):
        here = [row for row in result["rows"] if row["distance_cm"] == distance]
        for number, identity in enumerate(people):
            own = [row for row in here if row["identity"] == identity]
            _draw_person(axis, own, result["models"], COLOURS[number % len(COLOURS)])
        if _is_wide(row["total_ms"] for row in here):
            axis.set_xscale("log")
            plain_ticks(axis.xaxis)
        if _is_wide(row["mse"] for row in here):
            axis.set_yscale("log")
            plain_ticks(axis.yaxis)
        axis.margins(x=0.16, y=0.08)
        axis.set_title(f"{distance:g} cm", fontsize=9)
        axis.set_xlabel("decode + draw, ms")
    panels[0].set_ylabel("MSE, 0–255, held-out frames, mean of the views")
    handles = [
        Line2D([], [], marker="o", linestyle="", color=COLOURS[n % len(COLOURS)], label=name)
        for n, name in enumerate(people)
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=6, frameon=False, fontsize=8)
    finish(figure, _source(line), size=6)
    figure.draw_without_rendering()  # labels go where points have come to lie
    for axis, distance in zip(panels, shown, strict=True):
        here = [row for row in result["rows"] if row["distance_cm"] == distance]
        _label(axis, here, result["models"], people)
    return figure


def _draw_person(axis: Axes, rows: Sequence[Row], models: Sequence[Row], colour: str) -> None:
    """Points with quartiles of the cost and the interval of the error; a line joins the best."""
    errors = {_key(model): model for model in models}
    for row in rows:
        error, x, y = errors[_key(row)], row["total_ms"], row["mse"]
        axis.errorbar(
            x,
            y,
            xerr=[[x - row["total_ms_low"]], [row["total_ms_high"] - x]],
            yerr=[[y - error["mse_low"]], [error["mse_high"] - y]],
            fmt="s" if row["variant"] == "baseline" else "o",
            color=colour,
            ecolor=(colour, 0.5),
            elinewidth=0.6,
        )
    best = sorted((row["total_ms"], row["mse"]) for row in rows if row["is_best"])
    axis.plot(*zip(*best, strict=True), color=colour, linewidth=0.8, alpha=0.4, zorder=0)


def _label(axis: Axes, rows: Sequence[Row], models: Sequence[Row], people: Sequence[str]) -> None:
    """Write names beside points, moved up or down where they would lie on something else."""
    pixel = axis.figure.dpi / 72
    height = 1.1 * LABEL_SIZE * pixel
    points = axis.transData.transform([(row["total_ms"], row["mse"]) for row in rows])
    errors = {_key(model): model for model in models}
    taken = [box for row in rows for box in _marks(axis, row, errors[_key(row)])]
    for (x, y), row in sorted(zip(points, rows, strict=True), key=lambda pair: pair[0][1]):
        name = _short(row, rows)
        width = 0.55 * LABEL_SIZE * pixel * len(name)
        sides = {"left": x + 4 * pixel, "right": x - 4 * pixel - width}  # by alignment
        free = {
            side: (left, _free(left, y - height / 2, width, height, taken))
            for side, left in sides.items()
        }
        side = min(free, key=lambda each: abs(free[each][1] + height / 2 - y))
        left, bottom = free[side]
        taken.append((left, bottom, left + width, bottom + height))
        shift = (bottom + height / 2 - y) / pixel
        colour = COLOURS[people.index(row["identity"]) % len(COLOURS)]
        line = {"arrowstyle": "-", "linewidth": 0.3, "shrinkA": 0, "shrinkB": 0, "color": colour}
        axis.annotate(
            name,
            (row["total_ms"], row["mse"]),
            xytext=(4 if side == "left" else -4, shift),
            textcoords="offset points",
            ha=side,
            va="center",
            fontsize=LABEL_SIZE,
            color=colour,
            arrowprops=line if abs(shift) > LABEL_SIZE else None,
        )


def _marks(axis: Axes, row: Row, error: Row) -> list[Box]:
    """What is drawn of a point: itself and its two whiskers."""
    x, y = axis.transData.transform((row["total_ms"], row["mse"]))
    left, bottom = axis.transData.transform((row["total_ms_low"], error["mse_low"]))
    right, top = axis.transData.transform((row["total_ms_high"], error["mse_high"]))
    return [(x - 3, y - 3, x + 3, y + 3), (left, y - 1, right, y + 1), (x - 1, bottom, x + 1, top)]


def _free(left: float, bottom: float, width: float, height: float, taken: Sequence[Box]) -> float:
    """The nearest height, up or down, at which a box lies on no other."""

    def is_free(at: float) -> bool:
        return not any(
            left < box[2] and box[0] < left + width and at < box[3] and box[1] < at + height
            for box in taken
        )

    edges = [edge for box in taken for edge in (box[3], box[1] - height)]
    tried = sorted([bottom, *edges], key=lambda at: abs(at - bottom))
    return next(at for at in tried if is_free(at))


def _is_wide(values: Iterable[float]) -> bool:
    found = list(values)
    return max(found) > WIDE * min(found)


def _table(line: Line) -> str:
    result = line["result"]
    distances = sorted({row["distance_cm"] for row in result["rows"]})
    rows = {(_key(row), row["distance_cm"]): row for row in result["rows"]}
    main = min(distances, key=lambda cm: abs(cm - MAIN_CM))

    def total(distance: float) -> Column:
        text = "{total_ms:.1f} ({total_ms_low:.1f} to {total_ms_high:.1f})"
        return lambda model: text.format_map(rows[_key(model), distance])

    columns: dict[str, Column] = {
        "identity": "identity",
        "model": _name,
        "MSE": "{mse:.2f} ({mse_low:.2f} to {mse_high:.2f})",
        "decode, ms": lambda model: f"{rows[_key(model), main]['decode_ms']:.2f}",
        **{f"decode + draw at {distance:g} cm": total(distance) for distance in distances},
        "M parameters": lambda model: f"{model['parameters'] / 1e6:.3f}",
        "M multiply-adds": lambda model: f"{model['macs'] / 1e6:.1f}",
        "a pixel": "macs_per_pixel",
        "file, MB": lambda model: f"{model['file_bytes'] / 1e6:.2f}",
        "steps": "{steps:,}",
    }
    renderer = result["gl_renderer"].partition(" (")[0]
    note = (
        f"Medians of {result['frames']} frames in an image of {result['image_size']} pixels a "
        f"side, quartiles in brackets; ONNX Runtime on {result['threads']} thread"
        f"{'s' if result['threads'] > 1 else ''}, drawn with {renderer}."
    )
    return f"{table(result['models'], columns)}\n\n{note}\n\n{_source(line)}"


def _key(row: Row) -> tuple[str, str, str | None]:
    return row["identity"], row["variant"], row["block"]


def _name(row: Row) -> str:
    return f"{row['variant']} {row['block']}" if row["block"] else str(row["variant"])


def _short(row: Row, rows: Sequence[Row]) -> str:
    """The name, with a block where the variant has several."""
    blocks = {each["block"] for each in rows if each["variant"] == row["variant"]}
    return _name(row) if len(blocks) > 1 else str(row["variant"])


def _source(line: Line) -> str:
    """The source line, without a list of files that nobody would read."""
    if len(line["command"]) > MAX_COMMAND:
        line = line | {"command": f"pica bench models, {len(line['result']['models'])} models"}
    return source_line(line)
