"""A rig as a head of ours: one chart without overlaps, eyes that turn, regions, small errors."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import xatlas

from helpers.rig_toy import glb_bytes, glb_parts, toy_rig, write_glb
from pica_core.avatar.arkit import EYE_YAW, NUM_ARKIT
from pica_core.capture.rig import chart
from pica_core.capture.rig.chart import add_gutters
from pica_core.capture.rig.gltf import read_rig
from pica_core.capture.rig.head import RigHead, make_rig
from pica_core.capture.stage.expressions import blend
from pica_core.capture.triangles import front_view, signed_areas, visibility
from pica_core.errors import CaptureError
from pica_core.types import FloatArray, IntArray

pytestmark = [pytest.mark.unit, pytest.mark.slow]


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> RigHead:
    return make_rig(read_rig(write_glb(tmp_path_factory.mktemp("rig") / "toy.glb", toy_rig())))


def assert_no_overlap(head: RigHead, size: int = 256) -> None:
    """No texel centre lies in two triangles of the mesh, but for those on rims; gutters may."""
    chart = head.chart
    hits = np.zeros((size, size), np.int32)
    own = chart.faces[: len(head.mesh.faces)]
    corners = chart.vertex_uv[own].astype(np.float64) * size - 0.5
    for a, b, c in corners:
        low = np.maximum(np.ceil(np.min([a, b, c], axis=0)), 0).astype(int)
        high = np.floor(np.max([a, b, c], axis=0)).astype(int)
        if (high < low).any():
            continue
        x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        sides = [
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        inside = np.all(np.array(sides) > 1e-6, axis=0) | np.all(np.array(sides) < -1e-6, axis=0)
        hits[y[inside], x[inside]] += 1
    assert hits.max() == 1


def test_the_chart_holds_every_triangle_once(toy: RigHead) -> None:
    chart = toy.chart

    assert chart.vertex_uv.min() >= 0
    assert chart.vertex_uv.max() <= 1
    own = len(toy.mesh.faces)
    assert (chart.source[chart.faces[:own]] == toy.mesh.faces).all()
    assert (chart.face_source[:own] == np.arange(own)).all()
    assert_no_overlap(toy)


def test_islands_reach_under_each_other_at_seams_that_are_seen(toy: RigHead) -> None:
    chart, own = toy.chart, len(toy.mesh.faces)
    gutters = chart.faces[own:]
    copied = chart.face_source[own:]

    assert 10 < len(gutters) <= 2 * 35  # the seam at the back of the toy's head, as far as seen
    assert (toy.features.part[copied] == 0).all()
    np.testing.assert_array_equal(chart.source[gutters], toy.mesh.faces[copied])
    rest = toy.vertices(np.zeros(NUM_ARKIT))
    a, b, c = (rest[gutters[:, k]] for k in range(3))
    d, e, f = (rest[chart.faces[copied][:, k]] for k in range(3))
    turned = (np.cross(b - a, c - a) * np.cross(e - d, f - d)).sum(1)
    assert (turned > 0).all()  # they face where the triangles face that they copy


def test_skirts_leave_no_gap_at_the_vertices_of_a_seam() -> None:
    rows, columns = 6, 4
    index = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.stack([a, b, d, a, d, c], -1).reshape(-1, 3).astype(np.int32)
    y, x = np.divmod(np.arange(index.size), columns + 1)
    rest = np.stack([x, y, np.zeros_like(x)], 1).astype(np.float64)
    # Cut in the middle: the right half gets its own vertices and lies elsewhere in the plane.
    right = rest[faces].mean(1)[:, 0] > columns / 2
    split = faces.copy()
    split[right] += len(rest)
    points = np.concatenate([rest[:, :2], rest[:, :2] + 10.0])

    tips, gutters, far, copied = add_gutters(
        points, split, rest, faces, np.ones(len(faces), np.bool_), 9.0
    )

    plane = np.concatenate([points, tips])
    areas = signed_areas(plane.astype(np.float32), gutters)
    assert (areas > 0).all()
    # A strip of one column on either side, but for a triangle at one of its ends.
    assert areas.sum() == pytest.approx(2 * (rows - 0.5))
    source = np.concatenate([np.tile(np.arange(len(rest)), 2), far])
    np.testing.assert_array_equal(source[gutters], faces[copied])


def test_eyeballs_that_the_shapes_leave_alone_are_turned_about_their_centres(toy: RigHead) -> None:
    eye = toy.mesh.eyes[0]
    mine = np.flatnonzero(np.isin(toy.chart.source, eye.vertices))
    front = mine[toy.vertices(np.zeros(NUM_ARKIT))[mine, 2].argmax()]

    looking = toy.vertices(blend(eyeLookOutLeft=1.0, eyeLookInRight=1.0))
    rest = toy.vertices(np.zeros(NUM_ARKIT))

    before, after = rest[front] - eye.centre_m, looking[front] - eye.centre_m
    assert np.linalg.norm(after) == pytest.approx(np.linalg.norm(before), rel=1e-4)
    turned = np.arctan2(after[0], after[2]) - np.arctan2(before[0], before[2])
    assert turned == pytest.approx(EYE_YAW, abs=1e-3)  # to the subject's left
    other = np.setdiff1d(
        np.arange(len(toy.chart.source)), np.flatnonzero(toy.topology.regions["eyeballs"])
    )
    np.testing.assert_allclose(looking[other], rest[other], atol=1e-6)


def test_regions_lie_where_their_names_say(toy: RigHead) -> None:
    regions, mesh = toy.features.regions, toy.mesh
    eyes = np.array([eye.centre_m for eye in mesh.eyes])

    assert regions["lids"].sum() > 5
    distance = np.linalg.norm(mesh.rest_m[regions["lids"]][:, None] - eyes[None], axis=2).min(1)
    assert distance.max() < 0.03
    assert regions["teeth"].sum() > 20
    assert toy.features.mouth is not None
    assert np.mean(toy.features.mouth.y) == pytest.approx(-0.045 - 0.008, abs=0.006)
    assert regions["lips"].any()
    assert not regions["ears"].any()  # the toy has none
    assert (mesh.rest_m[regions["left"], 0] > 0).all()


def test_a_rig_without_texture_coordinates_gets_some(tmp_path: Path) -> None:
    document, binary = glb_parts(toy_rig())
    for primitive in document["meshes"][0]["primitives"]:
        del primitive["attributes"]["TEXCOORD_0"]
    (path := tmp_path / "bare.glb").write_bytes(glb_bytes(document, binary))

    head = make_rig(read_rig(path))

    assert head.mended == len(head.mesh.faces)
    assert_no_overlap(head)


@pytest.mark.parametrize(("step_m", "most_tries"), [(0.0, 9), (1e-4, 3)])
def test_a_head_that_is_drawn_many_times_is_packed_as_once_or_a_few_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, toy: RigHead, step_m: float, most_tries: int
) -> None:
    packed, add = [], xatlas.Atlas.add_uv_mesh

    def counted(atlas: xatlas.Atlas, points: FloatArray, faces: IntArray) -> None:
        packed.append(np.unique(points[faces].reshape(len(faces), 6), axis=0))
        assert len(packed[-1]) == len(faces)  # alike in one place, they take a long time
        add(atlas, points, faces)

    document, binary = glb_parts(toy_rig())
    place = document["nodes"][0]
    document["nodes"] = [place | {"translation": [k * step_m, 0, 0]} for k in range(4)]
    document["scenes"] = [{"nodes": list(range(4))}]
    (path := tmp_path / "many.glb").write_bytes(glb_bytes(document, binary))
    monkeypatch.setattr(xatlas.Atlas, "add_uv_mesh", counted)
    monkeypatch.setattr(chart, "MAX_PACKED", 9 * len(toy.chart.faces))

    head = make_rig(read_rig(path))

    assert len(packed) <= most_tries
    assert len(head.mesh.faces) == len(toy.mesh.faces) * (4 if step_m else 1)


def test_more_islands_than_a_chart_holds_are_refused_before_they_are_packed() -> None:
    faces, rest = np.arange(6_003, dtype=np.int32).reshape(-1, 3), np.eye(3)[np.arange(6_003) % 3]
    with pytest.raises(CaptureError, match="2001 islands in one chart; up to 2000 are packed"):
        chart.pack(rest[:, :2], faces, faces, np.ones(2_001), rest=rest, seen=np.ones(2_001, bool))


def test_triangles_that_are_metres_wide_are_looked_at_in_bounded_memory() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-2.0, 2.0, (2000, 3))
    faces = rng.integers(0, 2000, (2000, 3)).astype(np.int32)
    tracemalloc.start()
    try:
        view = front_view(points, faces)
        seen = visibility([points, 8.0 * points], faces)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak_bytes < 320_000_000
    assert (seen >= 0).all()
    assert (view.face >= 0).any()
