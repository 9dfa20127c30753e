"""``scripts/training_trials.py``: short runs compared, runs spoilt, and a step's time."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from helpers.script import load_script
from helpers.small_capture import render_small
from pica_core.errors import TrainingOptionError
from pica_core.train.config import PRESETS, TrainConfig

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]


SCRIPT = load_script("training_trials")


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return render_small(tmp_path_factory.mktemp("capture"))


def test_recipes_give_points_of_their_curves(capture: Path, tmp_path: Path) -> None:
    names = ("as_is", "tracked_meshes")
    options = SCRIPT.TrialOptions(
        capture=capture, names=names, preset="tiny", share=0.05, looks=2, out=tmp_path
    )

    result = SCRIPT.recipes(options)

    assert [row["recipe"] for row in result["rows"]] == ["as_is"] * 2 + ["tracked_meshes"] * 2
    assert [row["step"] for row in result["rows"]] == [3, 6] * 2
    assert all(math.isfinite(row["mse"]) for row in result["rows"])
    assert result["rows"][0]["seconds"] < result["rows"][1]["seconds"]
    assert (result["identity"], result["frames"], result["share"]) == ("S1", 6, 0.05)
    assert len(list((tmp_path / "as_is-0" / "pictures").iterdir())) == 2


def test_failures_tell_what_came_of_each_seed(capture: Path) -> None:
    options = SCRIPT.TrialOptions(
        capture=capture, names=("kl_off",), preset="tiny", share=0.05, looks=2, seeds=2
    )

    rows = SCRIPT.failures(options)["rows"]

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
        SCRIPT.recipes(SCRIPT.TrialOptions(capture=capture, preset="tiny", **changes))


def test_every_recipe_and_every_failure_is_a_run_that_can_be() -> None:
    tiny = PRESETS["tiny"]

    recipes = {name: change(tiny) for name, change in SCRIPT.RECIPES.items()}
    failures = {name: failure.config(tiny) for name, failure in SCRIPT.FAILURES.items()}

    assert recipes.pop("as_is") == tiny
    assert all(config != tiny for config in recipes.values())
    spoilt_in_the_data = {"depth_outliers", "wrong_camera", "nothing"}
    assert {name for name, config in failures.items() if config == tiny} == (
        spoilt_in_the_data | {"no_smoothness"}  # tiny has none
    )
    for config in (*recipes.values(), *failures.values()):
        assert TrainConfig.from_json(config.to_json()) == config


def test_a_profile_of_steps_names_every_part(capture: Path) -> None:
    row = SCRIPT.steps(SCRIPT.StepOptions(capture=capture, preset="tiny", steps=2, threads=1))

    parts = sum(row[f"{part}_ms"] for part in SCRIPT.PARTS)
    assert all(row[f"{part}_ms"] > 0 for part in SCRIPT.PARTS)
    assert 0.5 * row["step_ms"] < parts < 1.5 * row["step_ms"]


def test_options_are_written_as_its_help_says(
    capture: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--preset", "tiny", "--steps", "1", "--threads", "1"]

    SCRIPT.main(["steps", "--capture", str(capture), *words])

    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (result["preset"], result["steps"]) == ("tiny", 1)
