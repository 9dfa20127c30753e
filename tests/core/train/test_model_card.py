"""What an avatar file says of its making."""

import json
from pathlib import Path

import pytest

from helpers.small_capture import render_small
from pica_core.capture.dataset.dataset import Capture
from pica_core.train.config import PRESETS
from pica_core.train.data.training import TrainingData
from pica_core.train.evaluate import evaluate
from pica_core.train.export import EVALUATION_FILE, model_card
from pica_core.train.train import open_trainer

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]


def test_the_card_says_what_was_measured_and_nothing_before(tmp_path: Path) -> None:
    capture = Capture.open(render_small(tmp_path / "capture"))
    config = PRESETS["tiny"]
    with open_trainer(TrainingData(capture), config, tmp_path / "run") as trainer:
        before = model_card(trainer, tmp_path / "run")
        rows = evaluate(trainer, max_frames=1)
        (tmp_path / "run" / EVALUATION_FILE).write_text(json.dumps(rows))
        after = model_card(trainer, tmp_path / "run")

    assert set(after) - set(before) == {"held_out_mse", "held_out_mse_live", "vertex_error"}
    assert before["training"] == "0 of 180 steps, seed 0"
    assert f"{len(capture.cameras)} cameras of" in before["frames"]
    for row in rows:
        if row["source"] == "encoder":
            assert f"{row['view']} {row['mse']:.1f}" in after["held_out_mse"]
