"""The built-in heads: topology, and what each expression does to it."""

import functools

import numpy as np
import pytest

from helpers.head_checks import grid_lines
from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES
from pica_core.capture.dataset.files import MAP_SIZE
from pica_core.capture.procedural.heads import HEADS, ProceduralHead, make_head
from pica_core.capture.stage.expressions import blend, sample_takes
from pica_core.errors import CaptureError, ShapeError

pytestmark = [pytest.mark.unit, pytest.mark.slow]

NAMES = sorted(HEADS)
EYE_ROW = 70
"""Skin row of the upper lid's inner edge; the lower lid's is the next row."""
UPPER_CONTACT_ROW, LOWER_CONTACT_ROW = 119, 130
"""Skin rows where the lips touch."""


@functools.cache
def head_of(name: str) -> ProceduralHead:
    return make_head(name)


@pytest.fixture(params=NAMES)
def head(request: pytest.FixtureRequest) -> ProceduralHead:
    return head_of(request.param)


def posed_mm(head: ProceduralHead, **shapes: float) -> np.ndarray:
    return head.vertices(blend(**shapes)) * 1000.0


def skin_row(head: ProceduralHead, vertices: np.ndarray, row: int) -> np.ndarray:
    rows, columns = grid_lines(head, "skin")
    grid = vertices[head.charts["skin"]].reshape(len(rows), len(columns), 3)
    return grid[int(np.flatnonzero(rows == row)[0])]


def eye_columns(head: ProceduralHead) -> np.ndarray:
    """Front columns inside the left eye's slit."""
    upper = skin_row(head, posed_mm(head), EYE_ROW)
    lower = skin_row(head, posed_mm(head), EYE_ROW + 1)
    return (upper[:, 1] - lower[:, 1] > 2.0) & (upper[:, 0] > 0) & (upper[:, 2] > 50)


def test_every_vertex_sits_on_a_texel_centre_of_its_own(head: ProceduralHead) -> None:
    texels = head.vertex_uv * MAP_SIZE - 0.5
    assert np.abs(texels - np.rint(texels)).max() < 1e-4
    assert len(np.unique(np.rint(texels).astype(int), axis=0)) == len(head.vertex_uv)


def test_faces_point_at_vertices_that_exist_and_use_all_of_them(head: ProceduralHead) -> None:
    assert head.faces.min() == 0
    assert set(np.unique(head.faces)) == set(range(len(head.vertex_uv)))


def test_charts_keep_two_texels_between_each_other() -> None:
    taken = np.zeros((MAP_SIZE, MAP_SIZE), int)
    for index, chart in enumerate(head_of("S1").charts, start=1):
        rows, columns = grid_lines(head_of("S1"), chart)
        top, left = max(rows[0] - 2, 0), max(columns[0] - 2, 0)
        around = taken[top : rows[-1] + 3, left : columns[-1] + 3]
        assert not around.any(), f"{chart} comes too near to chart {around.max()}"
        taken[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] = index


def test_no_face_is_degenerate_at_rest(head: ProceduralHead) -> None:
    a, b, c = (posed_mm(head)[head.faces[:, k]].astype(np.float64) for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    assert (area < 1e-5).mean() < 0.002


def test_faces_of_the_face_look_forward(head: ProceduralHead) -> None:
    vertices = posed_mm(head)
    chosen = head.regions["face"] & ~head.regions["lids"] & ~head.regions["lips"]
    forward = vertices[:, 2] > 75
    faces = head.faces[(chosen & forward)[head.faces].all(1)]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert len(faces) > 1000
    assert (np.cross(b - a, c - a)[:, 2] < 0).mean() < 0.02


def test_a_full_blink_leaves_less_than_a_third_of_a_millimetre_open(head: ProceduralHead) -> None:
    vertices = posed_mm(head, eyeBlink=1.0)
    inside = eye_columns(head)
    gap = skin_row(head, vertices, EYE_ROW)[inside] - skin_row(head, vertices, EYE_ROW + 1)[inside]
    assert inside.sum() > 8
    assert np.abs(gap[:, 1]).max() < 0.33


@pytest.mark.parametrize("blink", [0.0, 0.3, 0.6, 1.0])
def test_lids_stay_outside_the_eyeball(head: ProceduralHead, blink: float) -> None:
    vertices = posed_mm(head, eyeBlink=blink)
    centre = np.array([head.landmarks["eye_x"], 22.0, 76.5])
    lids = vertices[head.regions["lids"] & head.regions["left"]]
    assert np.linalg.norm(lids - centre, axis=1).min() > 12.1


def test_looks_turn_both_eyes_to_the_same_side(head: ProceduralHead) -> None:
    vertices = posed_mm(head, eyeLookOutLeft=1.0, eyeLookInRight=1.0) - posed_mm(head)
    for name in ("eye_left", "eye_right"):
        rows, columns = grid_lines(head, name)
        middle = head.charts[name].start + len(rows) * len(columns) // 2 + len(columns) // 2
        assert vertices[middle, 0] > 3.0  # the subject's left is +x


def test_jaw_open_takes_chin_and_lower_teeth_down_and_leaves_the_nose(head: ProceduralHead) -> None:
    moved = posed_mm(head, jawOpen=1.0) - posed_mm(head)
    teeth = moved[head.charts["teeth_lower"]]
    assert teeth[:, 1].min() < -25.0
    chin = skin_row(head, moved, 146)  # the front of the chin; row 150 lies under it
    assert chin[len(chin) // 2, 1] < -18.0
    assert np.abs(moved[head.charts["teeth_upper"]]).max() == 0.0
    nose = np.abs(skin_row(head, posed_mm(head), 92)[:, 0]) < 20.0
    assert np.abs(skin_row(head, moved, 92)[nose]).max() < 1.5


def test_mouth_close_brings_the_lips_together_over_an_open_jaw(head: ProceduralHead) -> None:
    def gap(**shapes: float) -> float:
        vertices = posed_mm(head, **shapes)
        upper = skin_row(head, vertices, UPPER_CONTACT_ROW)
        lower = skin_row(head, vertices, LOWER_CONTACT_ROW)
        middle = np.abs(upper[:, 0]) < 12
        middle &= upper[:, 2] > 60
        return float(np.abs(upper - lower)[middle, 1].max())

    assert gap(jawOpen=0.5) > 8.0
    assert gap(jawOpen=0.5, mouthClose=0.5) < gap() + 0.6


def test_mouth_close_alone_does_nothing(head: ProceduralHead) -> None:
    assert np.abs(posed_mm(head, mouthClose=1.0) - posed_mm(head)).max() == 0.0


@pytest.mark.parametrize("name", [name for name in ARKIT_NAMES if name.endswith("Left")])
def test_a_left_shape_moves_the_subjects_left_side(name: str) -> None:
    head = head_of("S1")
    moved = np.linalg.norm(posed_mm(head, **{name: 1.0}) - posed_mm(head), axis=1)
    assert moved.max() > 1.0
    if name in ("jawLeft", "mouthLeft"):
        shift = (posed_mm(head, **{name: 1.0}) - posed_mm(head))[moved > 1.0]
        assert shift[:, 0].mean() > 1.0
    else:
        left = head.regions["left"]
        assert (moved[left] ** 2).sum() > 20 * (moved[~left] ** 2).sum()


@pytest.mark.parametrize("name", [n for n in ARKIT_NAMES if n != "mouthClose"])
def test_every_shape_moves_something_and_spares_cranium_and_hair(name: str) -> None:
    head = head_of("S2")
    moved = np.linalg.norm(posed_mm(head, **{name: 1.0}) - posed_mm(head), axis=1)
    assert moved.max() > 1.0
    assert moved[head.regions["hair"] | head.regions["scalp"] | head.regions["collar"]].max() < 0.6


def test_mirrored_expressions_make_mirrored_skin() -> None:
    head = head_of("S1")
    chart = head.charts["skin"]
    shape = (*map(len, grid_lines(head, "skin")), 3)
    left = head.vertices(blend(mouthSmileLeft=1.0, eyeBlinkLeft=1.0))[chart].reshape(shape)
    right = head.vertices(blend(mouthSmileRight=1.0, eyeBlinkRight=1.0))[chart].reshape(shape)
    np.testing.assert_allclose(left[:, ::-1] * [-1, 1, 1], right, atol=2e-6)


def test_a_batch_equals_its_members(head: ProceduralHead) -> None:
    takes = sample_takes(12, 3)
    arkit = np.concatenate([take.arkit for take in takes])[:4]
    batch = head.vertices_batch(arkit)
    for values, vertices in zip(arkit, batch, strict=True):
        np.testing.assert_allclose(head.vertices(values), vertices, atol=1e-6)


def test_real_like_combinations_stay_finite_and_near_the_head(head: ProceduralHead) -> None:
    arkit = np.concatenate([take.arkit for take in sample_takes(60, 1)])
    vertices = head.vertices_batch(arkit)
    assert np.isfinite(vertices).all()
    assert np.abs(vertices - head.vertices(np.zeros(52))).max() < 0.06


def test_normals_are_unit_and_agree_across_the_seam(head: ProceduralHead) -> None:
    normals = head.normals(head.vertices(np.zeros(52)))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-4)
    grid = normals[head.charts["skin"]].reshape(*map(len, grid_lines(head, "skin")), 3)
    np.testing.assert_array_equal(grid[:, 0], grid[:, -1])


def test_identities_share_one_topology() -> None:
    first, second = (head_of(name) for name in NAMES[:2])
    np.testing.assert_array_equal(first.vertex_uv, second.vertex_uv)
    np.testing.assert_array_equal(first.faces, second.faces)
    assert np.abs(first.vertices(np.zeros(52)) - second.vertices(np.zeros(52))).max() > 0.003


def test_two_builds_of_a_head_are_bit_identical() -> None:
    again = ProceduralHead("S1")
    arkit = blend(jawOpen=0.4, mouthSmile=0.5)
    assert again.vertices(arkit).tobytes() == head_of("S1").vertices(arkit).tobytes()


def test_an_unknown_head_is_named_with_the_known_ones() -> None:
    with pytest.raises(CaptureError, match=r"'S99'.*S1, S2, S3, S4, S5, S6"):
        make_head("S99")


def test_a_wrong_number_of_shapes_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"\(51,\)"):
        head_of("S1").vertices(np.zeros(51))


def test_takes_hold_the_asked_number_of_frames_and_start_neutral() -> None:
    takes = sample_takes(64, 0)
    assert sum(len(take.arkit) for take in takes) == 64
    assert not takes[0].arkit[0].any()
    assert len({take.segment for take in takes}) == len(takes)
    assert {take.split for take in takes} == {"train", "test"}


def test_takes_are_low_rank_and_blink() -> None:
    arkit = np.concatenate(
        [take.arkit for take in sample_takes(400, 0) if take.segment[:3] == "SEN"]
    )
    spread = np.linalg.svd(arkit - arkit.mean(0), compute_uv=False) ** 2
    assert np.cumsum(spread)[15] / spread.sum() > 0.9
    assert (arkit[:, ARKIT_INDEX["eyeBlinkLeft"]] > 0.8).any()
