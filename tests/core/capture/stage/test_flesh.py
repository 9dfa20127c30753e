"""Folds, skin that slides, hair that swings and the tongue, on the coarse face model."""

import functools

import numpy as np
import pytest

from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.person.choices import draw_person
from pica_core.capture.person.subject import make_head
from pica_core.capture.rig.head import RigHead
from pica_core.capture.stage.expressions import blend
from pica_core.capture.stage.flesh import ROOM_M, SLACK_M, STILL, Flesh, sway
from pica_core.capture.stage.paint import split_parts
from pica_core.types import Float64Array, FloatArray

pytestmark = pytest.mark.unit
RAISED = {"browInnerUp": 1.0, "browOuterUp": 1.0}


@functools.cache
def living() -> tuple[RigHead, Flesh]:
    head, growth = make_head(draw_person(7, hair="bob"), coarse=True)
    return head, Flesh(head, growth)


def moved_m(swaying: Float64Array = STILL, **shapes: float) -> tuple[Float64Array, FloatArray]:
    """How far flesh moves each vertex of an expression, and how much it is folded."""
    head, flesh = living()
    arkit = blend(**shapes).astype(np.float32)
    vertices = head.vertices(arkit)
    before = vertices.astype(np.float64)
    folded = flesh.move(vertices, arkit, swaying)
    return vertices - before, folded


def test_skin_folds_when_it_loses_more_area_than_it_can_shrink() -> None:
    offset, folded = moved_m()
    assert np.abs(offset).max() < 1e-6
    assert not folded.any()
    head, _ = living()
    rest = head.vertices(np.zeros(52))
    brow_y = head.features.brow_y
    forehead = (rest[:, 1] > brow_y + 0.01) & (rest[:, 1] < brow_y + 0.04) & (rest[:, 2] > 0.07)
    strengths = (0.05, 0.6, 1.0)
    found = [moved_m(browInnerUp=s, browOuterUp=s)[1][forehead].max() for s in strengths]
    assert found[0] == 0.0  # it shrinks
    assert found[1] > 0.3 > found[2] - found[1]  # then a root, no line
    assert moved_m(**RAISED)[1][rest[:, 1] < brow_y - 0.06].max() < 0.3


def test_what_flesh_does_in_two_shapes_is_not_the_sum_of_what_it_does_in_each() -> None:
    jaw, smile = moved_m(jawOpen=0.8)[0], moved_m(mouthSmile=0.9)[0]
    both = moved_m(jawOpen=0.8, mouthSmile=0.9)[0]
    assert np.linalg.norm(both - jaw - smile, axis=1).max() > 0.0015


def test_skin_slides_by_no_more_than_its_slack() -> None:
    skin = split_parts(living()[0]) == MATERIALS.index("skin")
    for opened in (0.3, 1.0):
        far = np.linalg.norm(moved_m(jawOpen=opened)[0][skin], axis=1)
        assert 0.001 < far.max() < SLACK_M + 0.002


@pytest.mark.parametrize("angles", [(0.2, 0), (-0.25, 0.1), (0, 0.3), (0, -0.3)])
def test_hair_swings_most_at_its_tips_and_hardly_into_the_head(angles: tuple[int, int]) -> None:
    head, _ = living()
    hair = split_parts(head) == MATERIALS.index("hair")
    offset = moved_m(np.array([*angles, 0.0, 0.0]))[0]
    assert np.abs(offset[~hair]).max() < 1e-6
    rest = head.vertices(np.zeros(52))[hair]
    far = np.linalg.norm(offset[hair], axis=1)
    low = rest[:, 1] < np.quantile(rest[:, 1], 0.2)
    assert 0.01 < far[low].max() == far.max()
    out = rest / [0.065, np.inf, 0.110] ** np.array(2)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    assert (offset[hair] * out).sum(1).min() > -1.01 * ROOM_M


def test_a_tongue_moves_in_an_open_mouth_alone_and_keeps_its_length() -> None:
    head, _ = living()
    tongue = split_parts(head) == MATERIALS.index("tongue")
    lifted = np.array([0, 0, 1.0, 0.5])
    assert np.abs(moved_m(lifted)[0]).max() < 1e-6
    assert np.abs(moved_m(lifted, jawOpen=0.5, mouthClose=0.5)[0][tongue]).max() < 1e-6
    offset = moved_m(lifted, jawOpen=0.7)[0][tongue]
    assert 0.005 < np.abs(offset[:, 1]).max() < 0.03
    posed = head.vertices(blend(jawOpen=0.7))[tongue]
    lengths = [np.ptp(points, axis=0) for points in (posed, posed + offset)]
    assert np.linalg.norm(lengths[1]) == pytest.approx(np.linalg.norm(lengths[0]), rel=0.2)


def test_inertia_is_the_same_for_the_same_seed_and_take_and_stays_within_a_swing() -> None:
    times_s = np.arange(40) / 6
    found = np.concatenate([sway(7, take, times_s) for take in range(4)])
    assert 0.03 < np.abs(found[:, :2]).std() < np.abs(found[:, :2]).max() < 0.6
    assert np.abs(found[:, 2:]).max() <= 1
    np.testing.assert_array_equal(sway(7, 1, times_s), found[40:80])
    np.testing.assert_allclose(sway(7, 1, times_s[:5]), found[40:45])
    assert np.abs(found[40:80] - found[:40]).max() > 0.05
