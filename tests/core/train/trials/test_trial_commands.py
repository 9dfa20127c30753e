"""`pica bench recipes` and `pica bench failures`: short runs, compared."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from helpers.small_capture import render_small
from pica_core.errors import TrainingOptionError
from pica_core.train.cli.trials import TrialOptions, bench_failures, bench_recipes

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return render_small(tmp_path_factory.mktemp("capture"))


def test_recipes_give_points_of_their_curves(capture: Path, tmp_path: Path) -> None:
    names = ("as_is", "tracked_meshes")
    options = TrialOptions(
        capture=capture, names=names, preset="tiny", share=0.05, looks=2, out=tmp_path
    )

    result = bench_recipes(options)

    assert [row["recipe"] for row in result["rows"]] == ["as_is"] * 2 + ["tracked_meshes"] * 2
    assert [row["step"] for row in result["rows"]] == [3, 6] * 2
    assert all(math.isfinite(row["mse"]) for row in result["rows"])
    assert result["rows"][0]["seconds"] < result["rows"][1]["seconds"]
    assert (result["identity"], result["frames"], result["share"]) == ("S1", 6, 0.05)
    assert len(list((tmp_path / "as_is-0" / "pictures").iterdir())) == 2


def test_failures_tell_what_came_of_each_seed(capture: Path) -> None:
    options = TrialOptions(
        capture=capture, names=("kl_off",), preset="tiny", share=0.05, looks=2, seeds=2
    )

    rows = bench_failures(options)["rows"]

    assert [(row["failure"], row["seed"]) for row in rows] == [("kl_off", 0), ("kl_off", 1)]
    assert all(not row["diverged"] and len(row["curve"]) == 2 for row in rows)
    assert rows[0]["mse"] != rows[1]["mse"]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"names": ("as_was",)}, "no 'as_was'; known are as_is"),
        ({"share": 0.0}, "share is 0.0"),
        ({"looks": 0}, "looks is 0"),
        ({"seeds": 0}, "seeds is 0"),
    ],
)
def test_bad_options_are_named(capture: Path, changes: dict[str, object], told: str) -> None:
    with pytest.raises(TrainingOptionError, match=told):
        bench_recipes(TrialOptions(capture=capture, preset="tiny", **changes))  # type: ignore[arg-type]
