"""Training on what others publish: without truth, depth, expressions and some images."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from helpers.published_capture import SEGMENTS, write_published
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.dataset.multiface import mesh_path
from pica_core.errors import CaptureError
from pica_core.train.cli.train import ExportOptions, export
from pica_core.train.config import PRESETS
from pica_core.train.data import TrainingData
from pica_core.train.evaluate import evaluate, successor
from pica_core.train.train import open_trainer

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]

CONFIG = replace(PRESETS["tiny"], geometry_steps=2, joint_steps=6, driver_steps=4, joint_batch=4)


@pytest.fixture
def original(tmp_path: Path) -> Path:
    return write_published(tmp_path / "m--0001")


def test_a_published_capture_with_holes_is_trained_on(original: Path, tmp_path: Path) -> None:
    shutil.rmtree(original / "images" / SEGMENTS[2] / "right")
    (original / "images" / SEGMENTS[1] / "front" / "000001.png").unlink()
    data = TrainingData(Capture.open(original))

    with open_trainer(data, CONFIG, tmp_path / "run") as trainer:
        trainer.run()
        rows = evaluate(trainer)

    assert trainer.step == 8  # the driver phase needs expressions
    assert {row["source"] for row in rows} == {"encoder"}
    assert all(math.isfinite(row["mse"]) for row in rows)
    text = (tmp_path / "run" / "metrics.jsonl").read_text()
    lines = [json.loads(line) for line in text.splitlines()]
    notes = " ".join(line["text"] for line in lines if line["kind"] == "note")
    assert "no expressions" in notes
    assert "no exact meshes" in notes


def test_without_expressions_no_avatar_is_exported(original: Path, tmp_path: Path) -> None:
    data = TrainingData(Capture.open(original))
    config = replace(CONFIG, joint_steps=0)
    with open_trainer(data, config, tmp_path / "run") as trainer:
        trainer.run()
    options = ExportOptions(
        run=tmp_path / "run", capture=original, out=tmp_path / "a.pica", name="A"
    )
    with pytest.raises(CaptureError, match="no expressions"):
        export(options)
    assert not options.out.exists()


def test_the_change_does_not_span_a_frame_that_is_left_out(tmp_path: Path) -> None:
    capture = write_published(tmp_path / "m--0001", frames=4)
    before = TrainingData(Capture.open(capture))
    first, second, *_ = before.test_frames
    where = before.capture.frames[second]
    (capture / mesh_path(where.segment, where.name)).unlink()

    data = TrainingData(Capture.open(capture))

    first, second, third = data.test_frames
    assert successor(before, first) == second
    assert successor(data, first) is None
    assert successor(data, second) == third
