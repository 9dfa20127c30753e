"""A run that goes wrong says so, and never loses its last good checkpoint."""

import json
import math
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from helpers.published_capture import SEGMENTS, write_published
from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import CaptureError, TrainingDivergedError, TrainingError
from pica_core.train.cli.train import ExportOptions, TrainOptions, export, train
from pica_core.train.config import PAPER, PRESETS, TrainConfig
from pica_core.train.data import TrainingData
from pica_core.train.evaluate import evaluate
from pica_core.train.losses import PLAIN_WEIGHT, ROUGH_WEIGHTS
from pica_core.train.objectives import IMAGE_WEIGHT, KL_WEIGHT, MESH_WEIGHT
from pica_core.train.train import open_trainer, read_checkpoint, write_checkpoint

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]


def short(geometry: int, joint: int = 0, **changes: Any) -> TrainConfig:
    steps = {"geometry_steps": geometry, "joint_steps": joint, "driver_steps": 0}
    return replace(PRESETS["tiny"], **steps, **changes)


def metrics(run: Path, kind: str) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return [line for line in lines if line["kind"] == kind]


def test_a_frame_of_unheard_of_variance_spoils_no_weights(
    data: TrainingData, tmp_path: Path
) -> None:
    with open_trainer(data, short(2), tmp_path) as trainer:
        with torch.no_grad():
            trainer.model.encoder.get_parameter("log_variance.bias").fill_(200.0)
        losses = trainer.train_step()

        assert all(np.isfinite(value) for value in losses.values())
        assert losses["kl"] < 0.1  # exp(200) would be
        assert all(torch.isfinite(p).all() for p in trainer.model.parameters())


@pytest.mark.parametrize("checkpoint_every", [4, 100])  # on the way, and at the end alone
def test_weights_that_are_not_finite_are_never_saved(
    data: TrainingData, tmp_path: Path, checkpoint_every: int
) -> None:
    with open_trainer(data, short(4, checkpoint_every=checkpoint_every), tmp_path) as trainer:
        while trainer.step < 3:
            trainer.train_step()
        trainer.save()
        saved = (tmp_path / "checkpoint.pt").read_bytes()
        with torch.no_grad():
            unused = trainer.model.parameter_groups()["encoding"][0]  # in this phase
            unused.view(-1)[0] = torch.nan
        with pytest.raises(TrainingDivergedError, match="weights not finite"):
            trainer.run()

    assert (tmp_path / "checkpoint.pt").read_bytes() == saved


def test_a_run_that_its_seconds_cut_is_measured_and_goes_on(captured: Path, tmp_path: Path) -> None:
    cut = TrainOptions(
        capture=captured, out=tmp_path / "run", preset="tiny", seconds=0.1, eval_frames=1, threads=1
    )

    first = train(cut)
    second = train(replace(cut, resume=True))

    assert 0 < first["steps"] < second["steps"] < 100
    assert first["mse"] > 0


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, state = tmp_path / "checkpoint.pt", {"step": 1, "config": asdict(PRESETS["tiny"])}
    write_checkpoint(path, state)

    def fail(_: object, file: Path) -> None:
        file.write_bytes(b"half")
        raise RuntimeError("No space left on device")

    monkeypatch.setattr(torch, "save", fail)
    with pytest.raises(TrainingError, match=r"No space left.*the one before is whole"):
        write_checkpoint(path, state | {"step": 2})

    assert read_checkpoint(tmp_path)["step"] == 1
    assert list(tmp_path.iterdir()) == [path]
    path.write_bytes(b"not a checkpoint")
    with pytest.raises(TrainingError, match=r"checkpoint\.pt: not a readable checkpoint"):
        read_checkpoint(tmp_path)


def test_a_capture_without_depth_switches_its_losses_off_and_says_so_once(
    captured: Path, tmp_path: Path
) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    for entry in captured.iterdir():
        if entry.name != "depth":
            (bare / entry.name).symlink_to(entry)
    config = short(0, 2, depth=10.0, normal=1.0, pixels_per_image=0)

    with open_trainer(TrainingData(Capture.open(bare)), config, tmp_path / "run") as trainer:
        losses = trainer.train_step()
        trainer.run()

    assert set(losses) == {"image", "mesh", "kl"}
    (note,) = metrics(tmp_path / "run", "note")
    assert "no depth" in note["text"]


@pytest.mark.parametrize("variant", ["full", "coarse", "baseline"])
def test_a_model_takes_a_step_with_all_losses_on_tracked_meshes(
    data: TrainingData, tmp_path: Path, variant: str
) -> None:
    weights = {"depth": PAPER.depth, "normal": PAPER.normal, "smooth": PAPER.smooth}
    changes = {"mesh_source": "tracked", "pixels_per_image": 0, **weights}
    config = short(0, 1, variant=variant, **changes)

    with open_trainer(data, config, tmp_path) as trainer:
        mean_m = trainer.objectives.mean_m.clone()
        found = trainer.train_step()

    assert set(found) == {"image", "depth", "normal", "mesh", "kl", "smooth"}
    assert all(np.isfinite(value) for value in found.values())
    moved_mm = 1000 * (trainer.objectives.mean_m - mean_m).norm(dim=1).mean()
    assert 0 < moved_mm < 0.1  # V_mu follows at 1e-4 a step


def test_the_paper_preset_is_the_papers_settings() -> None:
    assert (PAPER.encoder, PAPER.mesh_source) == ("paper", "tracked")
    assert (PAPER.uv_encoding_size, PAPER.axis_encoding_size) == (1024, 10_000)
    assert PAPER.encoding_amplitude == 1.0
    assert (IMAGE_WEIGHT, PAPER.depth, PAPER.normal) == (2, 10, 1)
    assert (MESH_WEIGHT, PAPER.smooth, KL_WEIGHT) == (0.1, 1, 0.001)
    assert (PAPER.region_weight, PAPER.lid_weight) == (1, 1)
    assert (PAPER.frame_balance, PAPER.chroma) == (0, 0)
    assert (ROUGH_WEIGHTS, PLAIN_WEIGHT) == ({"hair": 1.25, "mouth": 1.25}, 0.25)
    assert (PAPER.geometry_steps, PAPER.joint_steps) == (0, 400_000)
    assert (PAPER.joint_batch, PAPER.pixels_per_image) == (4, 0)
    assert {PAPER.joint_rate, PAPER.pixel_rate, PAPER.encoding_rate} == {1e-3}
    assert PAPER.constant_rate
    assert PAPER.clip_norm == 0


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
    notes = " ".join(row["text"] for row in metrics(tmp_path / "run", "note"))
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
