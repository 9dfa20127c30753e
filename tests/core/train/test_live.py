"""The live encoder: what bends is found, geometry follows poses, colours their pictures."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.file import Avatar, avatar_file, load_avatar
from pica_core.avatar.linear import Bases, components_of
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.stage.expressions import sample_takes
from pica_core.capture.stage.synth import (
    Poses,
    pose_expressions,
    read_picture,
    read_poses,
    write_poses,
)
from pica_core.errors import CaptureError
from pica_core.model.interface import ExpressionEncoder as TrainedEncoder
from pica_core.train.config import PRESETS
from pica_core.train.data import TrainingData
from pica_core.train.objectives import GEOMETRY, Draw, regress, regress_geometry
from pica_core.train.train import Trainer, open_trainer
from pica_core.types import NUM_LATENT, FloatArray

pytestmark = pytest.mark.train


@pytest.fixture(scope="module")
def nora() -> Avatar:
    return load_avatar(avatar_file(Path("nora")))


def expressions(count: int) -> FloatArray:
    found: FloatArray = np.concatenate([take.arkit for take in sample_takes(count, 3)])
    return found


def test_what_bends_where_the_encoder_does_is_found() -> None:
    arkit = torch.from_numpy(expressions(300))
    closed = arkit[:, [ARKIT_INDEX["eyeBlinkLeft"]]]
    wanted = torch.cat([closed, (closed - 0.4).clamp_min(0)], 1)

    matrix, offset = regress(arkit[:250], wanted[:250])

    found = TrainedEncoder.lifted(arkit[250:].double()) @ matrix.T + offset
    assert (found - wanted[250:]).abs().mean() < 0.02


def test_geometry_follows_poses_whatever_the_frames_are(nora: Avatar) -> None:
    count = len(nora.tensors["mesh.vertex_uv"])
    components_m = components_of(nora.tensors, nora.manifest.position_scale_m)[:, :count]
    mean_m = nora.tensors["linear.mean"].reshape(-1, 3)[:count]
    bases = Bases(
        mean_m=mean_m, components_m=components_m, vertex_weights=np.ones(count, np.float32)
    )
    jaw, weight = ARKIT_INDEX["jawOpen"], nora.tensors["linear.weight"]
    arkit = pose_expressions(100, 0)
    posed_m = mean_m + 3 * arkit[:, jaw, None, None] * components_m[0]
    poses = Poses(arkit, posed_m.astype(np.float32))

    matrix, offset = regress_geometry(poses, bases, weight)

    open_jaw = torch.zeros(1, NUM_ARKIT)
    open_jaw[0, jaw] = 1.0
    latent = np.zeros(NUM_LATENT)
    latent[GEOMETRY] = (TrainedEncoder.lifted(open_jaw.double()) @ matrix.T + offset)[0].numpy()
    found = weight @ latent
    assert found[0] == pytest.approx(3, abs=0.1)
    assert np.abs(found[1:]).max() < 0.1


def test_poses_come_back_from_a_capture_within_a_hundredth_of_a_millimetre(tmp_path: Path) -> None:
    assert read_poses(tmp_path, 3) is None
    arkit = pose_expressions(12, 0)
    jaw = arkit[:, ARKIT_INDEX["jawOpen"], None, None].clip(0, 0.5)
    meshes_m = np.array([(0, 0, 0), (0, 0.02, 0), (0.1, 0, 0)]) - jaw * [[[0], [0.1], [0]]]
    poses = Poses(arkit, meshes_m.astype(np.float32))
    write_poses(tmp_path, poses.arkit, poses.vertices_m)
    found = read_poses(tmp_path, 3)
    assert found is not None
    assert np.array_equal(found.arkit, poses.arkit)
    assert np.abs(found.vertices_m - poses.vertices_m).max() < 2e-5
    with pytest.raises(CaptureError, match=r"poses.npz: meshes are \(3, 3\); 4 are needed"):
        read_poses(tmp_path, 4)


def live_loss(trainer: Trainer) -> float:
    """On the same pictures and pixels whenever it is asked for."""
    with torch.no_grad():
        batches = [trainer.objectives.prepare("live", Draw(seed, 0)) for seed in range(8)]
        parts = [trainer.objectives.live(batch)["live"] for batch in batches]
    return float(torch.stack(parts).mean())


def test_a_capture_shows_every_pose_by_one_of_its_cameras(captured: Path) -> None:
    capture = Capture.open(captured)
    poses = read_poses(captured, len(capture.topology.vertex_uv))
    assert poses is not None
    assert len(poses.cameras) == len(poses.arkit) == 40
    assert set(poses.cameras) == {camera.name for camera in capture.cameras}
    pictures = [read_picture(captured, number) for number in range(40)]
    assert {picture.shape for picture in pictures} == {(128, 128, 3)}
    assert min(picture.std() for picture in pictures) > 10  # a head, each


@pytest.mark.usefixtures("one_thread")
def test_live_colours_are_learned_from_pictures_of_poses_and_geometry_stays(
    captured: Path, tmp_path: Path
) -> None:
    data = TrainingData(Capture.open(captured))
    config = replace(PRESETS["tiny"], variant="linear", joint_steps=80, live_steps=60)
    with open_trainer(data, config, tmp_path) as trainer:
        trainer.run(lambda step, phase, losses: trainer.total_steps - step > 59)
        at_start, weight = live_loss(trainer), live_weight(trainer)
        trainer.run()
        assert live_loss(trainer) < 0.8 * at_start
        after = live_weight(trainer)
    changed = (after != weight).reshape(-1, 4, after.shape[1]).any(2).any(0)
    assert changed.tolist() == [False, True, True, True]


def live_weight(trainer: Trainer) -> torch.Tensor:
    last = trainer.model.expression_encoder.layers[-1]
    assert isinstance(last, torch.nn.Linear)
    return last.weight.detach().clone()


@pytest.mark.usefixtures("one_thread")
def test_without_pictures_the_live_encoder_is_the_regression(
    captured: Path, tmp_path: Path
) -> None:
    poses = read_poses(captured, len(Capture.open(captured).topology.vertex_uv))
    assert poses is not None
    copy = tmp_path / "capture"
    shutil.copytree(captured, copy)
    write_poses(copy, poses.arkit, poses.vertices_m)
    with open_trainer(
        TrainingData(Capture.open(copy)),
        replace(PRESETS["tiny"], variant="linear"),
        tmp_path / "run",
    ) as trainer:
        assert trainer.phase_of(trainer.total_steps - 1) == ("driver", 0, 1)
