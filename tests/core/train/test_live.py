"""The live encoder in closed form: what bends is found, and geometry follows poses."""

from pathlib import Path

import numpy as np
import pytest
import torch

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.file import Avatar, load_avatar
from pica_core.avatar.linear import components_of, mean_vertices
from pica_core.avatar.shipped import avatar_file
from pica_core.capture.stage.expressions import sample_takes
from pica_core.capture.stage.poses import pose, read_poses, write_poses
from pica_core.errors import CaptureError
from pica_core.latent import NUM_LATENT
from pica_core.model.bases import Bases
from pica_core.model.interface import ExpressionEncoder as TrainedEncoder
from pica_core.train.live import GEOMETRY, regress, regress_geometry
from pica_core.types import FloatArray

pytestmark = pytest.mark.train


@pytest.fixture(scope="module")
def nora() -> Avatar:
    return load_avatar(avatar_file(Path("nora")))


def posed(arkit: FloatArray) -> FloatArray:
    """A mesh of three vertices; the second follows the jaw, and stops half-way."""
    jaw = arkit[ARKIT_INDEX["jawOpen"]]
    return np.array([(0, 0, 0), (0, -min(jaw, 0.5) / 10, 0), (0.1, 0, 0)], np.float32)


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
    mean_m = mean_vertices(nora.tensors, count)
    bases = Bases(
        mean_m=mean_m, components_m=components_m, vertex_weights=np.ones(count, np.float32)
    )
    jaw, weight = ARKIT_INDEX["jawOpen"], nora.tensors["linear.weight"]
    poses = pose(lambda arkit: mean_m + 3 * arkit[jaw] * components_m[0], 100, 0)

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
    poses = pose(posed, 12, 0)
    write_poses(tmp_path, poses)
    found = read_poses(tmp_path, 3)
    assert found is not None
    assert np.array_equal(found.arkit, poses.arkit)
    assert np.abs(found.vertices_m - poses.vertices_m).max() < 2e-5
    with pytest.raises(CaptureError, match=r"poses.npz: meshes are \(3, 3\); 4 are needed"):
        read_poses(tmp_path, 4)


def test_a_damaged_file_of_poses_is_named(tmp_path: Path) -> None:
    (tmp_path / "poses.npz").write_bytes(b"PK no archive")
    with pytest.raises(CaptureError, match=r"poses.npz: is damaged"):
        read_poses(tmp_path, 3)
