"""What the stage gets wrong on purpose, as trackers and stereo methods do; and how heads move."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.small_capture import small_head
from pica_core.camera import look_at
from pica_core.capture.dataset.dataset import Topology
from pica_core.capture.rig.head import RigHead
from pica_core.capture.stage.expressions import blend
from pica_core.capture.stage.mvs_depth import OUTLIER_RATIO, find_depth
from pica_core.capture.stage.tracked_topology import track_topology
from pica_core.capture.stage.tracker import LIMIT_MM, SimulatedTracker, head_to_world, lagged_arkit

pytestmark = [pytest.mark.unit, pytest.mark.slow]


@pytest.fixture(scope="module")
def head() -> RigHead:
    return small_head(coarse=False)


@pytest.fixture(scope="module")
def dense(head: RigHead) -> Topology:
    return head.topology


@pytest.fixture(scope="module")
def tracked(head: RigHead, dense: Topology) -> tuple[Topology, np.ndarray]:
    shapes = [blend(), blend(jawOpen=0.7), blend(eyeBlink=1.0)]
    return track_topology(dense, np.stack([head.vertices(each) for each in shapes]))


def edges_of(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def test_the_tracked_mesh_is_7000_of_the_dense_vertices_in_one_sheet(
    head: RigHead, dense: Topology, tracked: tuple[Topology, np.ndarray]
) -> None:
    topology, index = tracked
    assert 6500 <= len(index) <= 7500
    own = ~topology.region("mouth_cover")
    assert len(np.unique(index[own])) == own.sum()
    np.testing.assert_array_equal(topology.vertex_uv[own], dense.vertex_uv[index][own])
    assert edges_of(topology.faces)[1].max() == 2  # no edge has three triangles
    vertices = head.vertices(blend())[index]
    a, b, c = (vertices[topology.faces[:, i]] for i in range(3))
    outwards = head.normals(head.vertices(blend()))[index][topology.faces].mean(axis=1)
    inwards = (np.cross(b - a, c - a) * outwards).sum(1) < 0
    assert inwards[own[topology.faces].all(1)].mean() < 0.002


def test_the_mouth_of_the_tracked_mesh_opens(
    head: RigHead, tracked: tuple[Topology, np.ndarray]
) -> None:
    topology, index = tracked
    edges, uses = edges_of(topology.faces)
    slit = np.unique(edges[uses == 1])
    slit = slit[topology.regions["lips"][slit]]
    opened = head.vertices(blend(jawOpen=0.7))[index][slit]
    middle = np.abs(opened[:, 0]) < 0.008
    assert np.ptp(opened[middle, 1]) > 0.01


def test_a_tracker_errs_smoothly_by_less_than_a_millimetre(
    head: RigHead, tracked: tuple[Topology, np.ndarray]
) -> None:
    topology, index = tracked
    rest = head.vertices(blend())[index]
    tracker = SimulatedTracker(topology, rest, 3, index)

    moments = [tracker.follow(rest, rest, 0, time) - rest for time in (0.0, 1 / 30, 4.0)]
    other_take = tracker.follow(rest, rest, 1, 0.0) - rest

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


def test_lips_that_move_fast_are_tracked_late(
    head: RigHead, tracked: tuple[Topology, np.ndarray]
) -> None:
    topology, index = tracked
    before, now = blend().astype(np.float32), blend(jawOpen=0.35).astype(np.float32)
    behind = lagged_arkit(now, np.stack([before, before]))
    exact = head.vertices(now)[index]
    tracker = SimulatedTracker(topology, head.vertices(blend())[index], 3, index)

    late = tracker.follow(exact, head.vertices(behind)[index], 0, 0.0)
    prompt = tracker.follow(exact, exact, 0, 0.0)

    lips = topology.regions["lips"]
    low = lips & (exact[:, 1] < np.median(exact[lips, 1]))
    assert (late - prompt)[low, 1].mean() > 0.0003  # above where the lip is now
    assert np.abs((late - prompt)[topology.regions["collar"]]).max() == 0
    np.testing.assert_allclose(lagged_arkit(now, np.stack([now, now])), now, atol=1e-7)


def ball(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Exact depth and mask of a ball of 10 cm, a metre away; its right half is hair."""
    at = (np.arange(size) + 0.5) / size - 0.5
    x, y = np.meshgrid(0.3 * at, 0.3 * at)
    inside = 0.01 - x**2 - y**2
    depth = np.where(inside > 0, 1.0 - np.sqrt(np.maximum(inside, 0)), 0.0).astype(np.float32)
    mask = np.where(depth > 0, np.where(x > 0, 7, 1), 0).astype(np.uint8)
    return depth, mask


def found(size: int = 256, outlier_ratio: float = OUTLIER_RATIO) -> tuple[np.ndarray, ...]:
    depth, mask = ball(size)
    camera = look_at(
        centre_m=(0, 0, 1), target_m=(0, 0, 0), vertical_fov=0.3, width=size, height=size
    )
    random = np.random.default_rng(0)
    names = {0: "background", 1: "skin", 7: "hair"}
    return depth, mask, find_depth(depth, mask, camera, names, random, outlier_ratio)


def test_found_depth_has_holes_at_the_rim_and_in_hair() -> None:
    depth, mask, result = found()
    assert (result[depth == 0] == 0).all()
    radius = np.hypot(*np.meshgrid(np.arange(256) - 127.5, np.arange(256) - 127.5)) * 0.3 / 256
    assert (result[(radius > 0.0985) & (depth > 0)] == 0).all()
    middle = radius < 0.06
    assert (result[middle & (mask == 1)] > 0).mean() > 0.93
    assert 0.15 < (result[middle & (mask == 7)] > 0).mean() < 0.55


def test_noise_of_found_depth_grows_where_the_surface_turns_away() -> None:
    depth, mask, result = found(outlier_ratio=0.0)
    radius = np.hypot(*np.meshgrid(np.arange(256) - 127.5, np.arange(256) - 127.5)) * 0.3 / 256
    seen = (result > 0) & (mask == 1)
    facing, turned = seen & (radius < 0.03), seen & (radius > 0.085)
    near, far = (np.std(result[part] - depth[part]) for part in (facing, turned))
    assert 0.0001 < near < 0.0002
    assert far > 1.5 * near


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
