"""A run that goes wrong says so, goes back if it can, and never loses its last good checkpoint."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from helpers.small_capture import render_small
from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import CheckpointError, TrainingDivergedError, TrainingMemoryError
from pica_core.model.encoder import MAX_LOG_VARIANCE, hold_log_variance
from pica_core.train.checkpoint import read_checkpoint, write_checkpoint
from pica_core.train.config import PAPER_LOSSES, PRESETS, LossConfig, TrainConfig
from pica_core.train.data.training import TrainingData
from pica_core.train.guard import EXPLOSION_FACTOR, PATIENCE, DivergenceGuard
from pica_core.train.loop import Losses, Trainer, open_trainer
from pica_core.train.monitor import Monitor

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return render_small(tmp_path_factory.mktemp("capture"))


@pytest.fixture(scope="module")
def data(folder: Path) -> TrainingData:
    return TrainingData(Capture.open(folder))


def short(geometry: int, joint: int = 0, **changes: Any) -> TrainConfig:
    tiny = PRESETS["tiny"]
    schedule = replace(
        tiny.schedule, geometry_steps=geometry, joint_steps=joint, driver_steps=0, joint_batch=2
    )
    return replace(tiny, schedule=schedule, **changes)


def rows(run: Path, kind: str) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return [line for line in lines if line["kind"] == kind]


class Poison:
    """Puts a NaN into the weights after chosen steps."""

    def __init__(self, trainer: Trainer, times: int) -> None:
        self.trainer = trainer
        self.times = times

    def __call__(self, step: int, phase: str, losses: Losses) -> bool:
        if step == 4 and self.times > 0:
            self.times -= 1
            with torch.no_grad():
                next(self.trainer.model.parameters()).view(-1)[0] = torch.nan
        return True


def test_a_run_that_diverges_once_goes_back_at_half_the_rates(
    data: TrainingData, tmp_path: Path
) -> None:
    config = short(6, checkpoint_every=3)
    with open_trainer(data, config, tmp_path) as trainer:
        trainer.run(Poison(trainer, 1))

        assert trainer.step == 6
        assert trainer.rollbacks == 1
        assert all(torch.isfinite(p).all() for p in trainer.model.parameters())

    (note,) = rows(tmp_path, "note")
    assert "rollback 1 to step 3" in note["text"]
    state = read_checkpoint(tmp_path / "checkpoint.pt")
    assert state["rollbacks"] == 1
    assert state["rate_scale"] == 0.5


def test_a_run_that_diverges_again_and_again_gives_up_and_keeps_its_checkpoint(
    data: TrainingData, tmp_path: Path
) -> None:
    config = short(6, checkpoint_every=3, max_rollbacks=2)
    with (
        open_trainer(data, config, tmp_path) as trainer,
        pytest.raises(TrainingDivergedError, match="after 2 rollbacks"),
    ):
        trainer.run(Poison(trainer, 99))

    assert read_checkpoint(tmp_path / "checkpoint.pt")["step"] == 3


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


def test_log_variances_are_bent_only_where_they_are_too_large() -> None:
    usual, large = torch.linspace(-40, 0, 50), torch.tensor([4.0, 60.0, 1e6], requires_grad=True)

    assert (hold_log_variance(usual) - usual).abs().max() < 0.02
    held = hold_log_variance(large)
    assert held.max() <= MAX_LOG_VARIANCE
    held[0].backward()
    assert large.grad is not None
    assert large.grad[0] == 0.5  # a way back


@pytest.mark.parametrize("checkpoint_every", [4, 100])  # on the way, and at the end alone
def test_weights_that_are_not_finite_are_never_saved(
    data: TrainingData, tmp_path: Path, checkpoint_every: int
) -> None:
    config = short(4, checkpoint_every=checkpoint_every, max_rollbacks=0)
    with open_trainer(data, config, tmp_path) as trainer:
        while trainer.step < 3:
            trainer.train_step()
        with torch.no_grad():
            unused = trainer.model.parameter_groups()["encoding"][0]  # in this phase
            unused.view(-1)[0] = torch.nan
        with pytest.raises(TrainingDivergedError, match="weights not finite"):
            trainer.run()

    assert not (tmp_path / "checkpoint.pt").exists()


def test_weights_of_a_run_that_is_told_to_stop_are_looked_at_before_they_are_saved(
    data: TrainingData, tmp_path: Path
) -> None:
    with open_trainer(data, short(6, checkpoint_every=3), tmp_path) as trainer:
        poison = Poison(trainer, 1)
        trainer.run(lambda *step: poison(*step) and step[0] < 4)

        assert trainer.step == 3
        assert all(torch.isfinite(p).all() for p in trainer.model.parameters())

    state = read_checkpoint(tmp_path / "checkpoint.pt")
    assert (state["step"], state["rollbacks"]) == (3, 1)


def test_losses_that_explode_are_told_from_a_rare_frame() -> None:
    guard = DivergenceGuard()
    for _ in range(100):
        assert guard.check("joint", {"image": 1.0, "mesh": 1.0}) is None

    assert guard.check("joint", {"image": 3 * EXPLOSION_FACTOR, "mesh": 1.0}) is None  # a rare one
    assert guard.check("joint", {"image": 1.0, "mesh": 1.0}) is None
    verdicts = [
        guard.check("joint", {"image": 3 * EXPLOSION_FACTOR, "mesh": 1.0}) for _ in range(PATIENCE)
    ]

    assert verdicts[:-1] == [None] * (PATIENCE - 1)
    assert verdicts[-1] is not None
    assert f"in {PATIENCE} steps" in verdicts[-1]


def test_a_new_phase_has_losses_of_its_own() -> None:
    guard = DivergenceGuard()
    for _ in range(100):
        guard.check("geometry", {"mesh": 1e-3})

    assert all(guard.check("joint", {"image": 10.0}) is None for _ in range(100))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's /dev/full")
def test_a_full_disk_leaves_the_checkpoint_of_before(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    write_checkpoint(path, {"step": 1, "weights": torch.zeros(100_000)})
    path.with_suffix(".part").symlink_to("/dev/full")  # every write there ends in "no space left"

    with pytest.raises(CheckpointError, match=r"No space left.*the one before is whole"):
        write_checkpoint(path, {"step": 2, "weights": torch.zeros(100_000)})

    assert read_checkpoint(path)["step"] == 1
    assert not path.with_suffix(".part").exists()


def test_a_batch_that_does_not_fit_is_named(data: TrainingData, tmp_path: Path) -> None:
    config = short(1)
    config = replace(config, schedule=replace(config.schedule, geometry_batch=10**14))

    with (
        open_trainer(data, config, tmp_path) as trainer,
        pytest.raises(TrainingMemoryError, match="lower geometry_batch"),
    ):
        trainer.run()


def test_a_capture_without_depth_switches_its_losses_off_and_says_so_once(
    folder: Path, data: TrainingData, tmp_path: Path
) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    for entry in folder.iterdir():
        if entry.name != "depth":
            (bare / entry.name).symlink_to(entry)
    config = short(0, 2, losses=LossConfig(depth=10, normal=1))

    with open_trainer(TrainingData(Capture.open(bare)), config, tmp_path / "run") as trainer:
        losses = trainer.train_step()
        trainer.run()

    assert set(losses) == {"image", "mesh", "kl"}
    (note,) = rows(tmp_path / "run", "note")
    assert "no depth" in note["text"]


def test_a_look_at_held_out_frames_is_written_and_changes_nothing(
    data: TrainingData, tmp_path: Path
) -> None:
    plain, watched = short(1, 1), short(1, 1, watch_every=1)
    with open_trainer(data, plain, tmp_path / "plain") as trainer:
        trainer.run()
        wanted = trainer.model.state_dict()
    with open_trainer(data, watched, tmp_path / "watched") as trainer:
        trainer.run()
        found = trainer.model.state_dict()

    assert all(torch.equal(found[name], values) for name, values in wanted.items())
    assert len(rows(tmp_path / "watched", "held_out")) == 2
    assert len(list((tmp_path / "watched" / "pictures").iterdir())) == 2


def test_lines_and_pictures_stand_on_tensorboards_board_too(tmp_path: Path) -> None:
    monitor = Monitor(tmp_path)
    monitor.row(1, "train", {"image": 0.5})
    monitor.picture(2, np.full((4, 4, 3), 200, np.uint8))
    monitor.close()

    assert rows(tmp_path, "train") == [{"step": 1, "kind": "train", "image": 0.5}]
    assert (tmp_path / "pictures" / "0000002.png").exists()
    board = EventAccumulator(str(tmp_path / "board")).Reload()
    assert [(point.step, point.value) for point in board.Scalars("train/image")] == [(1, 0.5)]
    (shown,) = board.Images("held out")
    assert shown.step == 2
    with Image.open(io.BytesIO(shown.encoded_image_string)) as image:
        assert np.asarray(image).tolist() == np.full((4, 4, 3), 200).tolist()


@pytest.mark.parametrize("variant", ["full", "coarse", "baseline"])
def test_a_model_takes_a_step_with_all_losses_on_tracked_meshes(
    data: TrainingData, tmp_path: Path, variant: str
) -> None:
    model = replace(PRESETS["tiny"].model, variant=variant)
    config = short(0, 1, losses=PAPER_LOSSES, model=model, mesh_source="tracked")

    with open_trainer(data, config, tmp_path) as trainer:
        mean_m = trainer.objectives.mean_m.clone()
        found = trainer.train_step()

    assert set(found) == {"image", "depth", "normal", "mesh", "kl", "smooth"}
    assert all(np.isfinite(value) for value in found.values())
    moved_mm = 1000 * (trainer.objectives.mean_m - mean_m).norm(dim=1).mean()
    assert 0 < moved_mm < 0.1  # V_mu follows at 1e-4 a step


def test_the_paper_preset_is_the_papers_settings() -> None:
    paper = PRESETS["paper"]

    assert paper.model.encoder == "paper"
    assert paper.model.encoding_amplitude == 1.0
    assert paper.model.uv_encoding_size == 1024
    assert paper.model.axis_encoding_size == 10_000
    losses = paper.losses
    weights = (losses.image, losses.depth, losses.normal, losses.mesh, losses.smooth, losses.kl)
    assert weights == (2, 10, 1, 0.1, 1, 0.001)
    assert (losses.gradient, losses.laplacian) == (1, 0.1)
    assert (losses.region_weight, losses.lid_weight, paper.schedule.frame_balance) == (1, 1, 0)
    schedule = paper.schedule
    assert (schedule.geometry_steps, schedule.joint_steps) == (0, 400_000)
    assert (schedule.joint_batch, schedule.pixels_per_image) == (4, 0)
    rates = (schedule.joint_rate, schedule.pixel_rate, schedule.encoding_rate)
    assert rates == (1e-3, 1e-3, 1e-3)
    assert schedule.constant_rate
    assert schedule.clip_norm == 0
    assert paper.mesh_source == "tracked"
    assert paper.detach_pixel_xyz
