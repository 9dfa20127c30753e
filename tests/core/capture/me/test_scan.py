"""Scans: what cannot be one, and one whose truth is known."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from helpers.face_networks import face_networks
from helpers.own_head import Truth, write_scan
from pica_core.capture.me.face import head_faces
from pica_core.capture.me.register import Registered, register
from pica_core.capture.me.report import report_scan
from pica_core.capture.me.scan import read_scan
from pica_core.capture.me.scanned import head_of_scan, unwrap
from pica_core.capture.person.choices import read_model
from pica_core.capture.triangles import nearest, samples
from pica_core.errors import CaptureError
from pica_core.face_networks import FaceNetworks
from pica_core.types import Float64Array

pytestmark = pytest.mark.render

VIEWS = [(azimuth, 0.0) for azimuth in (-40.0, -20.0, 0.0, 20.0, 40.0)]
SPACING_M = 0.0004
SPHERE = trimesh.creation.icosphere(subdivisions=5)


def points_alone(path: Path) -> None:
    trimesh.PointCloud(np.random.default_rng(0).normal(size=(50, 3))).export(path)


@pytest.mark.parametrize(
    ("name", "write", "message"),
    [
        ("none.glb", lambda path: None, "No such file"),
        ("scan.stl", lambda path: path.write_bytes(b"solid"), "export it as GLB"),
        ("torn.glb", lambda path: path.write_bytes(b"glTF" + bytes(9)), "cannot be read"),
        ("cloud.ply", points_alone, "a mesh, not a cloud"),
        ("box.obj", lambda path: trimesh.creation.box().export(path), "12 triangles"),
    ],
)
def test_a_file_that_is_no_scan_is_named_with_a_remedy(
    tmp_path: Path, name: str, write: object, message: str
) -> None:
    assert callable(write)
    write(tmp_path / name)
    with pytest.raises(CaptureError, match=message) as caught:
        read_scan(tmp_path / name)
    assert name in str(caught.value)


def test_a_scan_of_too_many_triangles_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    SPHERE.export(tmp_path / "head.ply")
    monkeypatch.setattr("pica_core.capture.me.scan.MOST_TRIANGLES", 10_000)
    with pytest.raises(CaptureError, match="20,480 triangles; up to 10,000"):
        read_scan(tmp_path / "head.ply")


@pytest.fixture
def networks(monkeypatch: pytest.MonkeyPatch) -> FaceNetworks:
    """The networks, where few views are drawn and a small texture is made."""
    patches = {"register.FINDING": [(1.05, 0.0)], "register.VIEWS": VIEWS}
    for name, value in (patches | {"scanned.TEXTURE_SIZE": 256}).items():
        monkeypatch.setattr(f"pica_core.capture.me.{name}", value)
    return face_networks()


def test_what_has_no_face_is_refused(tmp_path: Path, networks: FaceNetworks) -> None:
    SPHERE.export(tmp_path / "hand.ply")
    with pytest.raises(CaptureError, match="no face is found from any side"):
        register(read_scan(tmp_path / "hand.ply"), networks)


@pytest.mark.slow
def test_colours_pass_across_the_seams_of_the_chart() -> None:
    model = read_model()
    flat = unwrap(model, 256)
    row, column = np.nonzero(flat.seen)
    upper_left = ((row < 128) & (column < 80)).astype(np.float64)  # most of the face, cut off
    soft = flat.soften(upper_left, 8)
    near = KDTree(flat.at(model.mean.rest_m)).query_pairs(0.001, output_type="ndarray")
    apart = np.hypot(*(each[near[:, 0]] - each[near[:, 1]] for each in (row, column))) > 40
    cut = apart & (np.abs(np.diff(upper_left[near]))[:, 0] == 1)
    assert cut.sum() > 20
    assert np.median(np.abs(np.diff(soft[near[cut]]))) < 0.2
    assert flat.soften(np.ones(len(row)), 8) == pytest.approx(1)


def test_a_scan_in_millimetres_on_its_back_with_holes_gives_the_persons_shape(
    tmp_path: Path, networks: FaceNetworks
) -> None:
    truth = write_scan(tmp_path / "head.glb")
    found = register(read_scan(tmp_path / "head.glb"), networks)
    assert (found.unit, found.up) == ("mm", "+z")
    surface = face_error_m(found, found.rest_m, truth)
    mean = face_error_m(found, read_model().mean.rest_m, truth)
    assert surface < 0.0006 < mean
    head = head_of_scan(found, {"hair": "bald"})
    assert head.person.hair == "bald"
    assert (head.texture[..., 3] > 127).mean() > 0.4
    report_scan(tmp_path / "report.html", found, head)
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/jpeg") == 9
    assert all(each in page for each in head.guessed)


def face_error_m(found: Registered, rest_m: Float64Array, truth: Truth) -> float:
    """How far the skin of a face at rest ``[P, 3]`` lies from a true one where a head was found,
    metres: the median distance to samples of the surface."""
    model = read_model()
    moved = np.abs(model.mean.motion_m).max((0, 2)) > 0.001
    skin = np.unique(head_faces(model, "skin"))
    face = skin[moved[skin] & (rest_m[skin, 2] > 0.03) & (rest_m[skin, 1] < 0.06)]
    true_m = found.face.pose.undo(truth.points)
    near = (true_m[truth.faces].mean(1) - [0, -0.03, 0.07] < 0.1).all(1)
    faces = truth.faces[near & (true_m[truth.faces, 2].max(1) > 0.02)]
    which, weights = samples(true_m, faces, SPACING_M)
    _, apart = nearest(rest_m[face], np.einsum("nk,nkc->nc", weights, true_m[faces[which]]))
    return float(np.median(apart))
