"""What keeps a posed head whole: lids before eyeballs, lips before teeth, skin without folds."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.rig_toy import toy_rig, write_glb
from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.capture.rig.gltf import read_rig
from pica_core.capture.rig.head import FoldGuard, LidGuard, LipGuard, PoseGuard, RigHead, make_rig
from pica_core.types import BoolArray, Float64Array

pytestmark = pytest.mark.unit
CREASE_M = 0.004


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> RigHead:
    return make_rig(read_rig(write_glb(tmp_path_factory.mktemp("rig") / "toy.glb", toy_rig())))


def creased(toy: RigHead) -> tuple[Float64Array, int, BoolArray]:
    """The head at rest with one vertex of its brow pushed over its neighbours; which vertex; and
    which faces are skin."""
    mesh = toy.mesh
    vertex = int(np.linalg.norm(mesh.motion_m[ARKIT_INDEX["browInnerUp"]], axis=1).argmax())
    outer = toy.features.part == 0
    folded = mesh.rest_m.copy()
    ring = np.unique(mesh.faces[outer & (mesh.faces == vertex).any(1)])
    folded[vertex] += 4.0 * (folded[ring].mean(0) - folded[vertex])
    folded[vertex] += [3 * CREASE_M, 3 * CREASE_M, 0.0]
    return folded, vertex, outer


def test_a_lid_that_would_pass_through_its_eyeball_passes_before_it(toy: RigHead) -> None:
    eye, points = toy.mesh.eyes[0], toy.mesh.rest_m.copy()
    lid, before = np.flatnonzero(toy.mesh.of_part("skin"))[:8], np.array([0.0, 0.0, 1.0])
    points[lid] = eye.centre_m + 1.1 * eye.radius_m * before
    guard = LidGuard(replace(toy.mesh, rest_m=points.copy()))
    points[lid] = eye.centre_m + 0.5 * eye.radius_m * before

    moved = points.copy()
    guard.apply(moved)

    assert np.linalg.norm(moved[lid] - eye.centre_m, axis=1).min() > eye.radius_m
    np.testing.assert_allclose(moved[8:], points[8:], atol=2e-4)


def test_a_lip_that_would_sink_into_teeth_stays_before_them(toy: RigHead) -> None:
    mesh, teeth = toy.mesh, toy.mesh.rest_m[toy.features.regions["teeth"]]
    front = teeth[teeth[:, 2].argmax()]
    points = mesh.rest_m.copy()
    lip = int(np.flatnonzero(toy.features.regions["lips"])[0])
    points[lip] = front + np.array([0.0, 0.0, 0.002])
    guard = LipGuard(replace(mesh, rest_m=points.copy()), toy.features)
    at_rest = points.copy()
    guard.apply(at_rest)
    points[lip, 2] = front[2] - 0.003

    guard.apply(points)

    assert points[lip, 2] > front[2]
    around = np.unique(mesh.faces[(mesh.faces == lip).any(1)])
    assert (points[around, 2] > mesh.rest_m[around, 2]).any()  # the skin beside it goes along
    assert at_rest[lip, 2] == pytest.approx(front[2] + 0.002)  # where nothing is wrong it rests


@pytest.mark.parametrize("mend", [False, True])
def test_skin_that_folds_is_smoothed_and_what_folds_at_rest_only_to_mend(
    toy: RigHead, mend: bool
) -> None:
    mesh = toy.mesh
    folded, vertex, outer = creased(toy)

    posed, rested = folded.copy(), folded.copy()
    guard = FoldGuard(mesh, outer)
    while guard.apply(posed):
        pass
    known = FoldGuard(replace(mesh, rest_m=folded), outer, mend=mend)
    changed = known.apply(rested)

    assert np.linalg.norm(posed[vertex] - folded[vertex]) > CREASE_M
    assert changed == mend
    assert np.array_equal(rested, folded) == (not mend)
    far = np.linalg.norm(mesh.rest_m - mesh.rest_m[vertex], axis=1) > 0.06
    np.testing.assert_array_equal(posed[far], folded[far])


def test_a_head_at_rest_is_left_as_it_is(toy: RigHead) -> None:
    points = toy.mesh.rest_m.copy()
    PoseGuard(toy.mesh, toy.features).apply(points)
    np.testing.assert_allclose(points, toy.mesh.rest_m, atol=1e-4)
