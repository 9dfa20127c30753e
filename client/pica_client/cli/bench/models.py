"""`pica bench models`: error against milliseconds of the models of the paper's tables."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import OmitArgPrefixes, Positional

from pica_client.bench.eval_rows import EvalRows
from pica_client.bench.model_files import open_models
from pica_client.bench.models import ModelsBenchConfig, join_errors, run_models_bench
from pica_client.output import say


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchModelsOptions:
    """Options of `pica bench models`."""

    files: Positional[tuple[str, ...]]
    """What `pica export` wrote, or folders of it. A baseline's file does not say whom it shows;
    where avatars of several people are measured, write IDENTITY=FILE."""
    rows: tuple[Path, ...]
    """What `pica eval --json` printed of the same models, or recorded lines of it."""
    config: OmitArgPrefixes[ModelsBenchConfig]


def bench_models(options: BenchModelsOptions) -> dict[str, Any]:
    """Measure what trained models of the paper's tables cost, beside their held-out errors.

    Set LP_NUM_THREADS to say how many threads software GL takes.
    """
    rows = EvalRows.read(options.rows)
    models = open_models(options.files)
    result = run_models_bench(options.config, models, join_errors(models, rows))
    for row in result["rows"]:
        say(
            f"{row['distance_cm']:5g} cm  {row['identity']:4} {row['variant']:9}"
            f"{row['block'] or '':3} {row['pixels']:8d} px  decode {row['decode_ms']:7.2f} ms  "
            f"draw {row['draw_ms']:7.2f} ms  total {row['total_ms']:7.2f} ms  "
            f"MSE {row['mse']:7.2f} {'best' if row['is_best'] else ''}"
        )
    return result
