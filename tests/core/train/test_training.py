"""Training really learns, resumes to the same numbers, and ends in a file that can be used."""

import gc
import json
import math
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn.functional import linear, pixel_shuffle

from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar, save_avatar
from pica_core.capture.dataset.files import Topology
from pica_core.capture.triangles import components
from pica_core.errors import TrainingDivergedError, TrainingError
from pica_core.model import avatar
from pica_core.model.baseline import Connected
from pica_core.model.networks import Shuffled, sample_map
from pica_core.train.config import PRESETS, TrainConfig
from pica_core.train.data import TrainingData, rasterise_uv, view_direction
from pica_core.train.evaluate import evaluate, mean_mse
from pica_core.train.export import EVALUATION_FILE, fill_unseen, make_avatar, model_card
from pica_core.train.train import open_trainer, rate_ratio
from pica_core.types import FloatArray

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]

LEARNED_FACTOR = 4.0
"""How far the held-out error must fall in the smallest preset (seen: 6, from a start that
shows the mean texture already)."""


def short(geometry: int, joint: int, driver: int) -> TrainConfig:
    steps = {"geometry_steps": geometry, "joint_steps": joint, "driver_steps": driver}
    return replace(PRESETS["tiny"], texture_contrast=0.0, **steps)  # which starts at once


def test_the_smallest_preset_learns_the_held_out_frames(data: TrainingData, tmp_path: Path) -> None:
    with open_trainer(data, PRESETS["tiny"], tmp_path) as trainer:
        before = evaluate(trainer, max_frames=1)
        trainer.run()
        after = evaluate(trainer, max_frames=1)

    for source in ("encoder", "driver"):
        left, had = (mean_mse(rows, source) for rows in (after, before))
        assert left < had / LEARNED_FACTOR


def test_a_run_lets_go_of_what_the_one_before_has_read(data: TrainingData, tmp_path: Path) -> None:
    def run(name: str) -> "weakref.ref[TrainingData]":
        own = TrainingData(data.capture)
        with open_trainer(own, short(1, 1, 0), tmp_path / name) as trainer:
            trainer.run()
        return weakref.ref(own)

    gc.disable()  # as it seldom looks where few objects hold much
    try:
        before = run("one")
        run("two")
        assert before() is None
    finally:
        gc.enable()


def test_a_resumed_run_gives_the_numbers_of_an_uninterrupted_one(
    data: TrainingData, tmp_path: Path
) -> None:
    config = short(4, 4, 4)
    with open_trainer(data, config, tmp_path / "whole") as trainer:
        trainer.run()
        whole = trainer.model.state_dict()

    for stop in (3, 6, 10):  # within each phase
        with open_trainer(data, config, tmp_path / str(stop)) as trainer:
            while trainer.step < stop:
                trainer.train_step()
            trainer.save()
        with open_trainer(data, config, tmp_path / str(stop)) as trainer:
            trainer.restore()
            trainer.run()
            resumed = trainer.model.state_dict()

        assert all(torch.equal(resumed[name], values) for name, values in whole.items())


@pytest.mark.parametrize("variant", ["full", "baseline"])
def test_what_makes_steps_fast_leaves_the_losses_of_twenty_steps_within_rounding(
    variant: str, data: TrainingData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def losses_of(name: str) -> FloatArray:
        with open_trainer(data, replace(short(0, 20, 0), variant=variant), tmp_path / name) as run:
            return np.array([list(run.train_step().values()) for _ in range(20)])

    fast = losses_of("fast")
    monkeypatch.setattr(avatar, "lay_channels_last", lambda model: None)
    plain_shuffle = lambda self, x: pixel_shuffle(nn.Conv2d.forward(self, x), 2)  # noqa: E731
    monkeypatch.setattr(Shuffled, "forward", plain_shuffle)
    plain_layer = lambda self, x: linear(x, self.weight, self.bias)  # noqa: E731
    monkeypatch.setattr(Connected, "forward", plain_layer)
    plain = losses_of("plain")
    # Each step multiplies what rounding left by two or so.
    for steps, tolerance in ((1, 1e-5), (5, 1e-3), (20, 3e-2)):
        np.testing.assert_allclose(fast[:steps], plain[:steps], rtol=tolerance)


def test_a_run_of_another_capture_is_not_resumed(
    data: TrainingData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_trainer(data, short(1, 1, 1), tmp_path) as trainer:
        trainer.save()
    monkeypatch.setattr(data.meshes, "position_scale_m", 1.01 * data.meshes.position_scale_m)

    with (
        open_trainer(data, short(1, 1, 1), tmp_path) as trainer,
        pytest.raises(TrainingError, match="another capture"),
    ):
        trainer.restore()


def test_frames_far_from_the_mean_are_drawn_more_often(data: TrainingData) -> None:
    rng = np.random.default_rng(0)
    rarest = data.train_frames[int(np.argmax(data.rarity))]

    balanced = data.draw(4000, 1.0, rng).count(rarest)
    alike = data.draw(4000, 0.0, rng).count(rarest)

    ratio = data.rarity.max() / data.rarity.mean()
    assert ratio > 1.2
    assert balanced / alike == pytest.approx(ratio, rel=0.2)


def test_a_loss_that_is_not_finite_stops_the_run_and_keeps_the_checkpoint(
    data: TrainingData, tmp_path: Path
) -> None:
    with open_trainer(data, short(2, 0, 0), tmp_path) as trainer:
        trainer.save()
        saved = (tmp_path / "checkpoint.pt").read_bytes()
        with torch.no_grad():
            next(trainer.model.geometry.parameters()).fill_(torch.nan)

        with pytest.raises(TrainingDivergedError, match="step 1"):
            trainer.run()

    assert (tmp_path / "checkpoint.pt").read_bytes() == saved


def test_an_exported_avatar_encodes_as_the_model_does(data: TrainingData, tmp_path: Path) -> None:
    with open_trainer(data, short(1, 1, 1), tmp_path / "run") as trainer:
        trainer.run()
        avatar = make_avatar(
            trainer.model, data, name="T", identity="S1", licence="Apache-2.0", model_card={}
        )
        with torch.no_grad():
            wanted = trainer.model.expression_encoder(data.arkit[:1])[0].permute(1, 2, 0).numpy()
    span = avatar.manifest.view_span
    seen = [view_direction(data.images.camera(0, name)) for name in data.images.cameras_of(0)]
    yaws = [math.degrees(math.atan2(x, z)) for x, _, z in seen]
    assert span.min_yaw - 5 < min(yaws) < max(yaws) < span.max_yaw + 5
    save_avatar(tmp_path / "t.pica", avatar)

    latent = ExpressionEncoder(load_avatar(tmp_path / "t.pica")).encode(data.arkit[0].numpy())

    assert np.abs(latent - wanted).max() < 0.01  # weights are stored as fp16


def test_the_card_says_what_was_measured_and_nothing_before(
    data: TrainingData, tmp_path: Path
) -> None:
    with open_trainer(data, short(1, 1, 1), tmp_path) as trainer:
        before = model_card(trainer, tmp_path)
        rows = evaluate(trainer, max_frames=1)
        (tmp_path / EVALUATION_FILE).write_text(json.dumps(rows))
        after = model_card(trainer, tmp_path)

    assert set(after) - set(before) == {"held_out_mse", "held_out_mse_live", "vertex_error"}
    assert before["training"] == "0 of 3 steps, seed 0"
    assert f"{rows[0]['view']} {rows[0]['mse']:.1f}" in after["held_out_mse"]


def parts_of_texels(topology: Topology, size: int) -> FloatArray:
    """Which island and regions each texel belongs to, as a number; 0 outside. ``[size, size]``."""
    marks = np.stack(
        [components(topology.faces, len(topology.vertex_uv)), *topology.regions.values()], 1
    )
    _, part = np.unique(marks, axis=0, return_inverse=True)
    raster = rasterise_uv(topology.vertex_uv, topology.faces, size)
    found = np.zeros((size, size), np.float32)
    found[raster.covered] = 1 + part.reshape(-1)[raster.corners[:, 0]]
    return found


def test_unseen_texels_are_filled_from_their_own_part_of_the_surface(data: TrainingData) -> None:
    size, topology = 128, data.capture.topology
    raster = rasterise_uv(topology.vertex_uv, topology.faces, size)
    wanted = parts_of_texels(topology, size)[:, :, None]
    is_seen = np.ones((size, size), bool)
    is_seen[np.arange(size) % 32 >= 20] = False
    given = np.where(is_seen[:, :, None], wanted, np.float32(-1))

    filled = fill_unseen(given, is_seen, data)

    was_filled = raster.covered & ~is_seen & (filled[:, :, 0] != -1)
    assert was_filled.sum() > 0.5 * (raster.covered & ~is_seen).sum()
    assert np.array_equal(filled[was_filled], wanted[was_filled])
    assert np.array_equal(filled[is_seen], given[is_seen])


def test_the_position_map_of_a_mesh_gives_its_vertices_back(data: TrainingData) -> None:
    # But for vertices beside seams and lids, where a texel is shared.
    maps = data.meshes.position_map(0)[None]

    vertex_uv = torch.from_numpy(np.float32(data.capture.topology.vertex_uv))
    offsets = sample_map(maps, vertex_uv)[0].numpy() * data.meshes.position_scale_m
    wanted = data.meshes.dense_m[0] - data.meshes.dense_mean_m

    apart_m = np.abs(offsets - wanted).max(1)
    assert np.median(apart_m) < 1e-5
    assert np.quantile(apart_m, 0.9) < 1e-4


def test_learning_rates_rise_then_fall() -> None:
    ratios = [rate_ratio(index, 1000) for index in range(1000)]

    assert max(ratios) == pytest.approx(1, abs=0.01)
    assert ratios.index(max(ratios)) == pytest.approx(20, abs=1)
    assert ratios[-1] < 0.03
