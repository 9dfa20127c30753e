"""Ways to train against each other, runs spoilt on purpose, and where a step's time goes."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Sequence
from statistics import median

import matplotlib.pyplot as plt
from charting import (
    COLOURS,
    ROOT,
    Column,
    Line,
    Row,
    fill_in,
    finish,
    markdown_table,
    plain_ticks,
    read_lines,
    rows_where,
    save,
    source_line,
    table,
    values,
)
from matplotlib.figure import Figure
from training_trials import PARTS

PAGE = ROOT / "docs" / "training.md"
CURVES_PAGE = ROOT / "docs" / "results" / "linear.md"
MODELS = {"linear": "linear", "as_is": "full", "baseline": "baseline"}
"""Recipes of the long runs, and the rows of docs/variants.md that they train."""
STYLES = ("-", "--", ":")
PANEL_COLUMNS = 3
UNSPOILT = "nothing"


def chart_recipes() -> None:
    """The newest curves of each recipe."""
    if lines := read_lines("recipes"):
        rows = newest(lines, "recipe")
        save(_draw_recipes(rows, lines[-1]), "recipes")
        text = "![error against seconds of training, by recipe](results/recipes.svg)"
        fill_in(PAGE, "recipes", f"{text}\n\n{_recipe_table(rows)}")


def chart_curves() -> None:
    """The newest long run of each model on one head, against steps and against seconds."""
    if lines := read_lines("training-curves"):
        rows = newest(lines, "recipe")
        save(_draw_curves(rows, lines[-1]), "training-curves")
        text = "![error of three models against steps and seconds](training-curves.svg)"
        fill_in(CURVES_PAGE, "training-curves", f"{text}\n\n{_curve_table(rows)}")


def chart_failures() -> None:
    """The newest curves of each failure."""
    if lines := read_lines("failures"):
        rows = newest(lines, "failure")
        save(_draw_failures(rows, lines[-1]), "failures")
        text = "![error of spoilt runs over their steps](results/failures.svg)"
        fill_in(PAGE, "failures", f"{text}\n\n{_failure_table(rows)}")


def chart_step() -> None:
    """The newest times of a training step, by the options that they were measured with."""
    if lines := read_lines("training-step"):
        newest_by_command = {line["command"]: line for line in lines}
        fill_in(PAGE, "training-step", _step_table(list(newest_by_command.values())))


def newest(lines: Iterable[Line], key: str) -> list[Row]:
    """Rows by name; what a later line measures again replaces what an earlier one has."""
    found: dict[str, list[Row]] = {}
    for line in lines:
        rows = line["result"]["rows"]
        for name in dict.fromkeys(row[key] for row in rows):
            found[name] = [row for row in rows if row[key] == name]
    return [row for rows in found.values() for row in rows]


def _draw_recipes(rows: Sequence[Row], line: Line) -> Figure:
    figure, axis = plt.subplots(figsize=(7.2, 4.6), layout="constrained")
    names = list(dict.fromkeys(row["recipe"] for row in rows))
    for number, name in enumerate(names):
        for seed in sorted({row["seed"] for row in rows if row["recipe"] == name}):
            points = [row for row in rows if (row["recipe"], row["seed"]) == (name, seed)]
            axis.plot(
                [row["seconds"] for row in points],
                [row["mse"] for row in points],
                color=COLOURS[number % len(COLOURS)],
                linestyle=STYLES[number // len(COLOURS) % len(STYLES)],
                linewidth=2.0 if name == "as_is" else 1.0,
                label=name.replace("_", " ") if seed == 0 else None,
            )
    worst = max(_ends(rows, name) for name in names)
    axis.set_yscale("log")
    axis.set_ylim(top=4 * worst)  # before images are seen, colours are noise
    plain_ticks(axis.yaxis)
    axis.set_xlabel("seconds of training")
    axis.set_ylabel("MSE, 0–255, held-out frames from the front")
    axis.legend(frameon=False, fontsize=7, ncols=2)
    return finish(figure, _foot(line), size=6)


def _draw_curves(rows: Sequence[Row], line: Line) -> Figure:
    figure, axes = plt.subplots(1, 2, figsize=(7.2, 3.4), sharey=True, layout="constrained")
    for (recipe, model), colour in zip(MODELS.items(), COLOURS, strict=False):
        points = rows_where(rows, recipe=recipe)
        for axis, field in zip(axes, ("step", "seconds"), strict=True):
            axis.plot(values(points, field), values(points, "mse"), ".-", color=colour, label=model)
            axis.set_xlabel({"step": "steps", "seconds": "seconds of training"}[field])
    axes[0].set_yscale("log")
    plain_ticks(axes[0].yaxis)
    axes[0].set_ylabel("MSE, 0–255, held-out frames from the front", fontsize=8)
    axes[1].legend(frameon=False, fontsize=8)
    return finish(figure, _foot(line), size=6)


def _curve_table(rows: Sequence[Row]) -> str:
    """What each model has reached at the ends of the shorter runs, and its last four looks."""
    last = {recipe: rows_where(rows, recipe=recipe)[-1] for recipe in MODELS}
    header = ["model", "steps", "seconds", "MSE of the last four looks"]
    header += [f"at {last[recipe]['seconds']:.0f} s" for recipe in ("linear", "as_is")]
    lines = []
    for recipe, model in MODELS.items():
        points = rows_where(rows, recipe=recipe)
        cells = [model, last[recipe]["step"], f"{last[recipe]['seconds']:.0f}"]
        cells.append(", ".join(f"{point['mse']:.1f}" for point in points[-4:]))
        for until in ("linear", "as_is"):
            before = [row for row in points if row["seconds"] <= last[until]["seconds"]]
            cells.append(f"{before[-1]['mse']:.1f}")
        lines.append(cells)
    return markdown_table(header, lines)


def _foot(line: Line) -> str:
    """The source line, in as many lines as it takes."""
    return textwrap.fill(source_line(line), 110)


def _ends(rows: Iterable[Row], name: str) -> float:
    """The median over seeds of the last error of a recipe."""
    last: dict[int, float] = {}
    for row in rows:
        if row["recipe"] == name:
            last[row["seed"]] = row["mse"]
    return median(last.values())


def _recipe_table(rows: Sequence[Row]) -> str:
    names = dict.fromkeys(row["recipe"] for row in rows)
    lines = []
    for name in sorted(names, key=lambda name: _ends(rows, name)):
        own = [row for row in rows if row["recipe"] == name]
        seconds = max(row["seconds"] for row in own)
        lines.append([name.replace("_", " "), f"{seconds:.0f}", f"{_ends(rows, name):.1f}"])
    return markdown_table(["recipe", "seconds", "MSE at the end"], lines)


def _draw_failures(rows: Sequence[Row], line: Line) -> Figure:
    """A panel for each failure; the runs that nothing spoils lie behind."""
    names = [name for name in dict.fromkeys(row["failure"] for row in rows) if name != UNSPOILT]
    height = math.ceil(len(names) / PANEL_COLUMNS)
    figure, axes = plt.subplots(
        height,
        PANEL_COLUMNS,
        figsize=(2.6 * PANEL_COLUMNS, 2.0 * height),
        sharex=True,
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for axis in axes.flat[len(names) :]:
        axis.remove()
    for axis, name in zip(axes.flat, names, strict=False):
        for row in rows:
            if row["failure"] not in (name, UNSPOILT) or not row["curve"]:
                continue
            points = [(point["step"], point["mse"]) for point in row["curve"]]
            colour = COLOURS[1] if row["failure"] == name else "#999999"
            axis.plot(*zip(*points, strict=True), color=colour, linewidth=0.9)
            if row["diverged"]:
                axis.plot(*points[-1], "x", color=colour)
        axis.set_title(name.replace("_", " "), fontsize=8)
        axis.set_yscale("log")
    ends = [row["mse"] for row in rows if row["mse"] is not None]
    axes[0, 0].set_ylim(top=10 * max(ends))
    plain_ticks(axes[0, 0].yaxis)
    figure.supylabel("MSE, held-out frames from the front; grey: nothing spoilt", fontsize=8)
    return finish(figure, f"step\n{_foot(line)}", size=6)


def _failure_table(rows: Sequence[Row]) -> str:
    names = dict.fromkeys(values(rows, "failure"))
    by_name = [{"own": rows_where(rows, failure=name)} for name in names]
    columns: dict[str, Column] = {
        "spoilt": lambda row: row["own"][0]["failure"].replace("_", " "),
        "diverged": lambda row: f"{sum(values(row['own'], 'diverged'))} of {len(row['own'])}",
        "MSE": lambda row: _range(row["own"], "mse", 1),
        "vertices, mm": lambda row: _range(row["own"], "vertex_error_mm", 2),
        "deviation of codes": lambda row: _range(row["own"], "code_deviation", 2),
        "reach at 3 σ, mm": lambda row: _range(row["own"], "reach_3_sigma_mm", 0),
        "at 6 σ, mm": lambda row: _range(row["own"], "reach_6_sigma_mm", 0),
    }
    return table(by_name, columns)


def _step_table(lines: Sequence[Line]) -> str:
    """Medians of each part in milliseconds, and of the whole step with its quartiles."""
    columns: dict[str, Column] = {
        "preset and options": lambda row: (
            row["command"].partition("--preset ")[2].split(" --steps")[0]
        ),
        **{f"{part}, ms": f"{{{part}_ms:.0f}}" for part in PARTS},
        "step": "{step_ms:.0f} ({step_low_ms:.0f} to {step_high_ms:.0f})",
    }
    rows = [line["result"] | {"command": line["command"]} for line in lines]
    last = lines[-1]
    told = f"Medians of {last['result']['steps']} steps. {source_line(last)}"
    return f"{table(rows, columns)}\n\n{told}"


def _range(rows: Iterable[Row], key: str, digits: int) -> str | None:
    """Least and largest value over seeds."""
    values = [row[key] for row in rows if row.get(key) is not None]
    if not values:
        return None
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return low if low == high else f"{low} to {high}"
