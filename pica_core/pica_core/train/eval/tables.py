"""Rows of an evaluation as Markdown: the paper's tables, and what stands beside them."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from pica_core.avatar.variants import TABLE_1, TABLE_2
from pica_core.train.eval.metrics import bootstrap_interval
from pica_core.train.eval.truth import DEPTH_CAP_MM, NEAR_DISTANCE_M, NOT_ASKED, REGIONS

Rows = Sequence[Mapping[str, Any]]
Key = tuple[str, str, str, int]
"""Identity, variant, block of the decoders ("" where it is not told) and seed: a run."""
Model = tuple[str, str, str]
"""A key without its seed: runs that a table shows in one line."""

TABLES: Mapping[int, tuple[str, ...]] = {1: TABLE_1, 2: TABLE_2}
QUANTILES = (100, 90, 75, 50, 25, 10, 0)
_SPLITS = {"test": "held-out frames", "train": "frames that were trained on"}
_NONE = "–"


def error_table(rows: Rows, variants: Sequence[str]) -> str:
    """MSE by identity, model and view; the best of a view is bold.

    One seed stands with the interval over its frames, the mean of several with the lowest and the
    highest of them.
    """
    views = list(dict.fromkeys(row["view"] for row in rows))
    models = _models(map(_key, rows), variants)
    cells: dict[tuple[Model, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        cells.setdefault((_key(row)[:3], row["view"]), []).append(row)
    means = {at: float(np.mean([row["mse"] for row in found])) for at, found in cells.items()}
    lines: list[list[str]] = []
    for model in models:
        line = [model[0], _label(model, models)]
        for view in views:
            found = cells.get((model, view))
            if found is None:
                line.append(_NONE)
                continue
            mean = means[model, view]
            best = min(e for (other, at), e in means.items() if other[0] == model[0] and at == view)
            value = f"**{mean:.2f}**" if mean == best else f"{mean:.2f}"
            ends = [row["mse"] for row in found]
            if len(found) == 1:
                ends = [found[0]["mse_low"], found[0]["mse_high"]]
            line.append(f"{value} ({min(ends):.2f} to {max(ends):.2f})")
        lines.append(line)
    return _table(["identity", "model", *views], lines)


def summary_table(rows: Rows, variants: Sequence[str]) -> str:
    """What stands beside the MSE: means over views and seeds, and what the model costs."""
    models = _models(map(_key, rows), variants)
    lines: list[list[str]] = []
    for model in models:
        own = [row for row in rows if _key(row)[:3] == model]
        changes = [row["temporal_mse"] for row in own if row["temporal_mse"] is not None]
        first = own[0]
        lines.append(
            [
                model[0],
                _label(model, models),
                *(f"{np.mean([row[name] for row in own]):.{digits}f}" for name, digits in _MEANS),
                f"{np.mean(changes):.2f}" if changes else _NONE,
                f"{first['parameters'] / 1e6:.3f}",
                f"{first['macs'] / 1e6:.1f}",
                str(first["macs_per_pixel"]),
                str(first["steps"]),
                ", ".join(str(seed) for seed in sorted({row["seed"] for row in own})),
            ]
        )
    head = ["identity", "model", "MSE", "PSNR dB", "SSIM", "MSE of the change"]
    head += ["M parameters", "M multiply-adds", "a pixel", "steps", "seeds"]
    return _table(head, lines)


def distribution_table(distributions: Mapping[Key, Rows], variants: Sequence[str]) -> str:
    """The mean with its interval over seeds and frames, and how errors spread over expressions:
    quantiles of the frames' MSE, each the mean over seeds."""
    models = _models(distributions, variants)
    lines = []
    for model in models:
        values = _of_seeds(distributions, model)
        errors = np.array([list(of_seed.values()) for of_seed in values.values()])
        low, high = bootstrap_interval(errors)
        frames = errors.mean(0)
        shown = [f"{np.percentile(frames, quantile):.2f}" for quantile in QUANTILES]
        mean = f"{frames.mean():.2f} ({low:.2f} to {high:.2f})"
        lines.append([model[0], _label(model, models), mean, *shown])
    head = ["mean", "worst", *(f"{quantile} %" for quantile in QUANTILES[1:-1]), "best"]
    return _table(["identity", "model", *head], lines)


def paired_table(distributions: Mapping[Key, Rows], variants: Sequence[str]) -> str:
    """How much worse than the full model of the same seed each other one is, frame by frame: the
    interval of the mean difference is narrower than those of the means, which share what makes a
    frame hard."""
    models = _models(distributions, variants)
    lines = []
    for model in models:
        full = next((m for m in models if m[0] == model[0] and m[1] == "full"), None)
        if full is None or model[1] == "full":
            continue
        known, own = _of_seeds(distributions, full), _of_seeds(distributions, model)
        differences = [
            [error - known[seed][frame] for frame, error in frames.items() if frame in known[seed]]
            for seed, frames in own.items()
            if seed in known
        ]
        if not any(differences):
            continue
        low, high = bootstrap_interval(differences)
        each = np.mean(differences, axis=0)
        lines.append(
            [
                model[0],
                _label(model, models),
                f"{each.mean():+.2f} ({low:+.2f} to {high:+.2f})",
                f"{(each > 0).sum()} of {len(each)}",
            ]
        )
    return _table(["identity", "model", "MSE above full's", "worse frames"], lines)


def geometry_table(
    geometry: Mapping[Key, Mapping[str, float | None]],
    tracked: Mapping[str, Mapping[str, float | None]],
    variants: Sequence[str],
) -> str:
    """Depth errors by region, millimetres, means over seeds; the tracked mesh's own first."""
    measured = {key: errors for key, errors in geometry.items() if errors}
    models = _models(measured, variants)
    lines: list[list[str]] = []
    for identity, errors in tracked.items():
        if errors:
            lines.append([identity, "tracked mesh", *_millimetres([errors])])
        for model in models:
            if model[0] == identity:
                own = [errors for key, errors in measured.items() if key[:3] == model]
                lines.append([identity, _label(model, models), *_millimetres(own)])
    return _table(["identity", "model", *REGIONS], lines)


def near_table(near: Mapping[Key, Mapping[str, Any]], variants: Sequence[str]) -> str:
    """Errors of pictures from close to the mouth, means over seeds, or why there are none."""
    models = _models(near, variants)
    lines = []
    for model in models:
        own = [found for key, found in near.items() if key[:3] == model]
        told = [_NONE, *(f"skipped: {found['skipped']}" for found in own if "skipped" in found)][:2]
        if measured := [found for found in own if "mse" in found]:
            mean = np.mean([found["mse"] for found in measured])
            told = [f"{mean:.2f}", f"{measured[0]['frames']} frames"]
        lines.append([model[0], _label(model, models), *told])
    return _table(["identity", "model", "MSE", ""], lines)


def report(number: int, result: Mapping[str, Any], commands: Iterable[str] = ()) -> str:
    """The whole report of an evaluation.

    Args:
        number: Of the paper's table.
        result: Of `eval_commands.eval_runs`.
        commands: How the figures came about, to print with them.
    """
    variants = TABLES[number]
    rows = result["rows"]
    runs = {_key(run): run for run in result["runs"]}
    parts = [
        f"# Table {number}",
        f"MSE on 0-255 values over rasterised pixels, {_SPLITS[result.get('split', 'test')]}: the "
        "mean over seeds with the lowest and the highest of them, or of one seed with its 95 % "
        "bootstrap interval over frames. The captures' own note on what they are: "
        + "; ".join(sorted({str(run["source"]) for run in runs.values()})),
        *_sampling_part(rows[0].get("samples", 1), result.get("one_sample_mse", {})),
        error_table(rows, variants),
        "## Beside it",
        "Means over views. The change is the one from a frame to the next of its take.",
        summary_table(rows, variants),
        "## Over expressions",
        "MSE over all views: the mean with its 95 % bootstrap interval over seeds and frames, and "
        "single frames, sorted.",
        distribution_table({key: run["distribution"] for key, run in runs.items()}, variants),
        "## Against the full model",
        "Seed by seed and frame by frame, mean over views; 95 % bootstrap interval of the mean "
        "difference over seeds and frames.",
        paired_table({key: run["distribution"] for key, run in runs.items()}, variants),
        *(_geometry_part(runs, result["tracked_mesh"], variants)),
        *(_near_part(runs, variants)),
        *(f"`{command}`" for command in commands),
    ]
    return "\n\n".join(parts) + "\n"


def _sampling_part(samples: int, floors: Mapping[str, float | None]) -> list[str]:
    """How many samples a pixel is, unless it is the paper's one, and what one costs the heads
    themselves."""
    parts = [f"Drawn with {samples**2} samples a pixel."] if samples > 1 else []
    known = [f"{who} {error:.1f}" for who, error in floors.items() if error is not None]
    if known:
        parts.append(f"The heads themselves, drawn with one sample a pixel: {', '.join(known)}.")
    return parts


def _geometry_part(
    runs: Mapping[Key, Mapping[str, Any]],
    tracked: Mapping[str, Mapping[str, float | None]],
    variants: Sequence[str],
) -> list[str]:
    """Nothing where geometry was not measured."""
    if not any(run["geometry"] for run in runs.values()):
        return []
    return [
        "## Geometry",
        f"Mean depth error in mm (capped at {DEPTH_CAP_MM:g} mm) against the true mesh, at pixels "
        "that both cover, by region of the true mesh.",
        geometry_table({key: run["geometry"] for key, run in runs.items()}, tracked, variants),
    ]


def _near_part(runs: Mapping[Key, Mapping[str, Any]], variants: Sequence[str]) -> list[str]:
    """Nothing where nobody asked for it."""
    near = {key: run["near"] for key, run in runs.items()}
    if all(found.get("skipped") == NOT_ASKED for found in near.values()):
        return []
    return [
        "## Near field",
        f"From {100 * NEAR_DISTANCE_M:g} cm in front of the lips, where no camera stood.",
        near_table(near, variants),
    ]


_MEANS = (("mse", 2), ("psnr_db", 2), ("ssim", 4))


def _key(row: Mapping[str, Any]) -> Key:
    return row["identity"], row["variant"], row.get("block") or "", row["seed"]


def _models(keys: Iterable[Key], variants: Sequence[str]) -> list[Model]:
    """Sort by identity, then in the table's order; variants that it does not name are left out."""
    known = {key[:3] for key in keys if key[1] in variants}
    return sorted(known, key=lambda model: (model[0], variants.index(model[1]), model[2]))


def _of_seeds(distributions: Mapping[Key, Rows], model: Model) -> dict[int, dict[str, float]]:
    """MSE of each frame by its name, for each seed of a model."""
    return {
        key[3]: {item["frame"]: item["mse"] for item in frames}
        for key, frames in sorted(distributions.items())
        if key[:3] == model
    }


def _label(model: Model, models: Iterable[Model]) -> str:
    """The variant, with its block where it has several."""
    blocks = {other[2] for other in models if other[:2] == model[:2]}
    return model[1] + (f", block {model[2]}" if len(blocks) > 1 else "")


def _millimetres(errors: Sequence[Mapping[str, float | None]]) -> list[str]:
    """The mean of each region."""
    shown = []
    for name in REGIONS:
        known = [value for each in errors if (value := each.get(name)) is not None]
        shown.append(f"{np.mean(known):.2f}" if known else _NONE)
    return shown


def _table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    rows = [head, ["---"] * len(head), *lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
