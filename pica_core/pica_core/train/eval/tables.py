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

TABLES: Mapping[int, tuple[str, ...]] = {1: TABLE_1, 2: TABLE_2}
QUANTILES = (100, 90, 75, 50, 25, 10, 0)
_SPLITS = {"test": "held-out frames", "train": "frames that were trained on"}
_NONE = "–"


def error_table(rows: Rows, variants: Sequence[str]) -> str:
    """MSE by identity, model and view, with intervals; the best of a view is bold."""
    views = list(dict.fromkeys(row["view"] for row in rows))
    cells = {(_key(row), row["view"]): row for row in rows}
    lines: list[list[str]] = []
    for key in _runs(rows, variants):
        line = [key[0], _label(key, map(_key, rows))]
        for view in views:
            row = cells.get((key, view))
            best = min(r["mse"] for r in rows if r["view"] == view and r["identity"] == key[0])
            if row is None:
                line.append(_NONE)
                continue
            value = f"{row['mse']:.2f}"
            value = f"**{value}**" if row["mse"] == best else value
            line.append(f"{value} ({row['mse_low']:.2f} to {row['mse_high']:.2f})")
        lines.append(line)
    return _table(["identity", "model", *views], lines)


def summary_table(rows: Rows, variants: Sequence[str]) -> str:
    """What stands beside the MSE: means over views, and what the model costs."""
    lines: list[list[str]] = []
    for key in _runs(rows, variants):
        own = [row for row in rows if _key(row) == key]
        changes = [row["temporal_mse"] for row in own if row["temporal_mse"] is not None]
        first = own[0]
        lines.append(
            [
                key[0],
                _label(key, map(_key, rows)),
                *(f"{np.mean([row[name] for row in own]):.{digits}f}" for name, digits in _MEANS),
                f"{np.mean(changes):.2f}" if changes else _NONE,
                f"{first['parameters'] / 1e6:.3f}",
                f"{first['macs'] / 1e6:.1f}",
                str(first["macs_per_pixel"]),
                str(first["steps"]),
                str(first["seed"]),
            ]
        )
    head = ["identity", "model", "MSE", "PSNR dB", "SSIM", "MSE of the change"]
    head += ["M parameters", "M multiply-adds", "a pixel", "steps", "seed"]
    return _table(head, lines)


def distribution_table(distributions: Mapping[Key, Rows], variants: Sequence[str]) -> str:
    """How errors spread over expressions: quantiles of the frames' MSE."""
    lines = []
    for key in _sorted(distributions, variants):
        values = [item["mse"] for item in distributions[key]]
        shown = [f"{np.percentile(values, quantile):.2f}" for quantile in QUANTILES]
        lines.append([key[0], _label(key, distributions), *shown])
    head = ["worst", *(f"{quantile} %" for quantile in QUANTILES[1:-1]), "best"]
    return _table(["identity", "model", *head], lines)


def paired_table(distributions: Mapping[Key, Rows], variants: Sequence[str]) -> str:
    """How much worse than the full model each other one is, frame by frame: the interval of the
    mean difference is narrower than those of the means, which share what makes a frame hard."""
    lines = []
    for key in _sorted(distributions, variants):
        full = next((k for k in distributions if k[0] == key[0] and k[1] == "full"), None)
        if full is None or key[1] == "full":
            continue
        known = {item["frame"]: item["mse"] for item in distributions[full]}
        both = [item for item in distributions[key] if item["frame"] in known]
        if not both:
            continue
        differences = [item["mse"] - known[item["frame"]] for item in both]
        low, high = bootstrap_interval(differences)
        worse = sum(difference > 0 for difference in differences)
        lines.append(
            [
                key[0],
                _label(key, distributions),
                f"{np.mean(differences):+.2f} ({low:+.2f} to {high:+.2f})",
                f"{worse} of {len(both)}",
            ]
        )
    return _table(["identity", "model", "MSE above full's", "worse frames"], lines)


def geometry_table(
    geometry: Mapping[Key, Mapping[str, float | None]],
    tracked: Mapping[str, Mapping[str, float | None]],
    variants: Sequence[str],
) -> str:
    """Depth errors by region, millimetres; the tracked mesh's own first."""
    lines: list[list[str]] = []
    for identity, errors in tracked.items():
        if errors:
            lines.append([identity, "tracked mesh", *_millimetres(errors)])
        keys = [key for key in _sorted(geometry, variants) if key[0] == identity]
        lines += [
            [identity, _label(key, geometry), *_millimetres(geometry[key])]
            for key in keys
            if geometry[key]
        ]
    return _table(["identity", "model", *REGIONS], lines)


def near_table(near: Mapping[Key, Mapping[str, Any]], variants: Sequence[str]) -> str:
    """Errors of pictures from close to the mouth, or why there are none."""
    lines = []
    for key in _sorted(near, variants):
        found = near[key]
        if "skipped" in found:
            told = [_NONE, f"skipped: {found['skipped']}"]
        else:
            told = [f"{found['mse']:.2f}", f"{found['frames']} frames"]
        lines.append([key[0], _label(key, near), *told])
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
        f"MSE on 0-255 values over rasterised pixels, {_SPLITS[result.get('split', 'test')]}, mean "
        "and 95 % bootstrap interval over frames. The captures' own note on what they are: "
        + "; ".join(sorted({str(run["source"]) for run in runs.values()})),
        *_sampling_part(rows[0].get("samples", 1), result.get("one_sample_mse", {})),
        error_table(rows, variants),
        "## Beside it",
        "Means over views. The change is the one from a frame to the next of its take.",
        summary_table(rows, variants),
        "## Over expressions",
        "MSE of single frames, mean over views, sorted.",
        distribution_table({key: run["distribution"] for key, run in runs.items()}, variants),
        "## Against the full model",
        "Frame by frame, mean over views; 95 % bootstrap interval of the mean difference.",
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


def _runs(rows: Rows, variants: Sequence[str]) -> list[Key]:
    return _sorted({_key(row): row for row in rows}, variants)


def _sorted(keys: Iterable[Key], variants: Sequence[str]) -> list[Key]:
    """Sort by identity, then in the table's order; variants that it does not name are left out."""
    known = [key for key in keys if key[1] in variants]
    return sorted(known, key=lambda key: (key[0], variants.index(key[1]), *key[2:]))


def _label(key: Key, keys: Iterable[Key]) -> str:
    """The variant, with block and seed where it has several among `keys`."""
    _, variant, block, seed = key
    alike = {other for other in keys if other[:2] == key[:2]}
    label = variant
    if len({other[2] for other in alike}) > 1:
        label += f", block {block}"
    if len({other[3] for other in alike}) > 1:
        label += f", seed {seed}"
    return label


def _millimetres(errors: Mapping[str, float | None]) -> list[str]:
    return [_NONE if (e := errors.get(name)) is None else f"{e:.2f}" for name in REGIONS]


def _table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    rows = [head, ["---"] * len(head), *lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
