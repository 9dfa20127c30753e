"""What the stage gets wrong on purpose, as trackers do; and how heads move."""

import numpy as np
import pytest

from helpers.small_capture import small_head
from pica_core.capture.dataset.files import Topology
from pica_core.capture.rig.head import RigHead
from pica_core.capture.stage.expressions import blend
from pica_core.capture.stage.tracker import (
    LIMIT_MM,
    SimulatedTracker,
    head_to_world,
    track_topology,
)

pytestmark = [pytest.mark.unit, pytest.mark.slow]


@pytest.fixture(scope="module")
def head() -> RigHead:
    return small_head()


@pytest.fixture(scope="module")
def dense(head: RigHead) -> Topology:
    return head.topology


@pytest.fixture(scope="module")
def tracked(head: RigHead, dense: Topology) -> tuple[Topology, np.ndarray]:
    shapes = [blend(), blend(jawOpen=0.7), blend(eyeBlink=1.0)]
    return track_topology(dense, np.stack([head.vertices(each) for each in shapes]), 2000)


def edges_of(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def test_the_tracked_mesh_is_so_many_of_the_dense_vertices_in_one_sheet(
    head: RigHead, dense: Topology, tracked: tuple[Topology, np.ndarray]
) -> None:
    topology, index = tracked
    assert 1800 <= len(index) <= 2200
    assert len(np.unique(index)) == len(index)
    np.testing.assert_array_equal(topology.vertex_uv, dense.vertex_uv[index])
    assert edges_of(topology.faces)[1].max() == 2  # no edge has three triangles
    vertices = head.vertices(blend())[index]
    a, b, c = (vertices[topology.faces[:, i]] for i in range(3))
    outwards = head.normals(head.vertices(blend()))[index][topology.faces].mean(axis=1)
    inwards = (np.cross(b - a, c - a) * outwards).sum(1) < 0
    inside = topology.regions["mouth_interior"][topology.faces].any(1)
    assert inwards[~inside].mean() < 0.005


def test_a_tracker_errs_smoothly_by_less_than_a_millimetre(
    head: RigHead, tracked: tuple[Topology, np.ndarray]
) -> None:
    topology, index = tracked
    rest = head.vertices(blend())[index]
    tracker = SimulatedTracker(topology, rest, 3, index)

    moments = [tracker.follow(rest, 0, time) - rest for time in (0.0, 1 / 30, 4.0)]
    other_take = tracker.follow(rest, 1, 0.0) - rest

    size = np.linalg.norm(moments[0], axis=1)
    assert size.max() < LIMIT_MM / 1000
    assert 0.0001 < size.mean() < 0.0005
    start, end = edges_of(topology.faces)[0].T
    face = topology.regions["face"][start] & topology.regions["face"][end]
    step = np.linalg.norm((moments[0][start] - moments[0][end])[face], axis=1)
    assert step.mean() < 0.5 * size.mean()  # neighbours are off alike
    soon, later = (np.linalg.norm(moments[0] - other, axis=1).mean() for other in moments[1:])
    assert soon < 0.3 * later
    assert np.linalg.norm(moments[0] - other_take, axis=1).mean() > 0.5 * later


def test_a_head_moves_a_little_and_smoothly() -> None:
    poses = np.stack([head_to_world(0, 4, k / 30) for k in range(300)])
    turns = poses[:, :, :3]
    np.testing.assert_allclose(
        turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-12
    )
    nose = poses @ np.array([0, 0, 0.1, 1.0])
    assert 0.002 < nose.std(axis=0).max() < 0.03
    assert np.linalg.norm(np.diff(nose, axis=0), axis=1).max() < 0.006
    assert not np.allclose(poses[0], head_to_world(0, 5, 0))
