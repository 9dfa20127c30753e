"""What each expression moves on the built-in heads, and that nothing folds or pokes out."""

import functools

import numpy as np
import pytest

from helpers.head_checks import HeadChecks, front_depth, grid_lines
from helpers.head_zones import (
    LEAST_SHARE,
    MOST_ELSEWHERE_MM,
    Motion,
    all_motions,
    zones_of,
)
from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES
from pica_core.capture.procedural.heads import HEADS, make_head
from pica_core.capture.stage.expressions import sample_takes

pytestmark = [pytest.mark.unit, pytest.mark.slow]

NAMES = sorted(HEADS)
ONE_SIDED = [name for name in ARKIT_NAMES if not name.endswith("Right")]
"""Right shapes mirror left ones (`test_mirrored_expressions_make_mirrored_skin`)."""


@functools.cache
def motions_of(name: str) -> list[Motion]:
    return all_motions(make_head(name))


@functools.cache
def checks_of(name: str) -> HeadChecks:
    return HeadChecks(make_head(name))


def one(shape: str) -> np.ndarray:
    arkit = np.zeros(len(ARKIT_NAMES))
    arkit[ARKIT_INDEX[shape]] = 1.0
    return arkit


def test_every_shape_names_the_zones_that_it_moves() -> None:
    assert all(zones_of(name) for name in ARKIT_NAMES)
    assert len(HEADS) == 6


@pytest.mark.parametrize("name", NAMES)
def test_every_shape_moves_the_region_that_its_name_says(name: str) -> None:
    still = [(motion.shape, motion.peak_mm) for motion in motions_of(name) if motion.peak_mm < 1.0]
    assert not still


@pytest.mark.parametrize("name", NAMES)
def test_nine_tenths_of_every_shapes_motion_lie_in_its_region(name: str) -> None:
    strays = [(m.shape, m.share, m.moved) for m in motions_of(name) if m.share < LEAST_SHARE]
    assert not strays


@pytest.mark.parametrize("name", NAMES)
def test_no_shape_moves_much_outside_its_region(name: str) -> None:
    far = [
        (m.shape, m.elsewhere_mm) for m in motions_of(name) if m.elsewhere_mm > MOST_ELSEWHERE_MM
    ]
    assert not far


@pytest.mark.parametrize("name", NAMES)
def test_one_sided_shapes_stay_on_their_side(name: str) -> None:
    crossed = [(m.shape, m.side_share) for m in motions_of(name) if m.side_share < LEAST_SHARE]
    assert not crossed


@pytest.mark.parametrize("name", ["S2", "S3"])
def test_nothing_folds_or_pokes_out_at_any_full_shape(name: str) -> None:
    checks = checks_of(name)
    faults = {shape: checks.faults(one(shape)) for shape in ONE_SIDED}
    assert not {shape: found for shape, found in faults.items() if found.total}


def test_nothing_folds_or_pokes_out_in_a_sample_of_performances() -> None:
    arkit = np.concatenate([take.arkit for take in sample_takes(24, 5)])
    faults = [
        (name, checks_of(name).faults(values))
        for index, name in enumerate(NAMES)
        for values in arkit[index :: len(NAMES)]
    ]
    assert not [(name, found) for name, found in faults if found.total]


def test_an_eyeball_or_a_tooth_out_of_place_is_found() -> None:
    checks = checks_of("S1")
    regions = checks.head.regions
    eyes_out, teeth_out = checks.rest.copy(), checks.rest.copy()
    eyes_out[regions["eyeballs"], 2] += 4.0
    teeth_out[regions["teeth"], 2] += 14.0
    eyes, teeth = checks.poking(eyes_out)
    assert len(eyes) > 100
    assert len(teeth) == 0
    eyes, teeth = checks.poking(teeth_out)
    assert len(eyes) == 0
    assert len(teeth) > 100


def test_a_vertex_pulled_over_its_neighbours_is_a_fold() -> None:
    checks = checks_of("S1")
    rows, columns = grid_lines(checks.head, "skin")
    row, vertices = int(np.flatnonzero(rows == 54)[0]), checks.rest.copy()
    middle = row * len(columns) + len(columns) // 2
    vertices[checks.head.charts["skin"].start + middle] += [7.0, 7.0, 0.0]
    assert len(checks.folded(vertices)) > 0


def test_front_depth_is_the_nearest_of_the_faces_over_a_point() -> None:
    square = [[0, 0, 1], [4, 0, 1], [0, 4, 1], [0, 0, 3], [4, 0, 3], [0, 4, 3]]
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    depth = front_depth(np.array(square, float), faces, np.array([[1.0, 1, 0], [3.0, 3, 0]]))
    assert depth[0] == 3.0
    assert np.isinf(depth[1])
