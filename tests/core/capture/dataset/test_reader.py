"""Captures of others, and captures with holes."""

import logging
import shutil
from pathlib import Path

import numpy as np
import pytest

from helpers.published_capture import HEIGHT, PLACES_MM, SEGMENTS, WIDTH, write_published
from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import CaptureError

pytestmark = pytest.mark.unit


@pytest.fixture
def original(tmp_path: Path) -> Path:
    return write_published(tmp_path / "m--0001")


def test_a_published_directory_is_read_as_it_is(original: Path) -> None:
    capture = Capture.open(original)

    assert capture.is_published
    assert not capture.has_depth
    assert not capture.has_truth
    assert len(capture.frames) == 12
    assert (capture.cameras[0].width, capture.cameras[0].height) == (WIDTH, HEIGHT)
    frame = capture.frames[5]
    assert capture.image(frame, "left")[0, 0].tolist() == [5, 1, 50]
    texture = capture.average_texture(frame)
    assert texture[0].min() == 200
    assert texture[1:].max() == 0
    np.testing.assert_allclose(capture.head_to_world(frame)[:, 3], [0.01, 0.02, 0.03])
    assert frame.arkit is None


def test_a_published_mesh_has_a_vertex_for_each_side_of_a_seam(original: Path) -> None:
    capture = Capture.open(original)
    vertices = capture.vertices_m(capture.frames[0])
    uv = capture.tracked_topology.vertex_uv

    assert capture.tracked_topology is capture.topology
    assert vertices.shape == (6, 3)
    corners = vertices[capture.topology.faces]
    np.testing.assert_allclose(corners[0], PLACES_MM[[0, 1, 2]] / 1000)
    np.testing.assert_allclose(corners[1], PLACES_MM[[3, 2, 1]] / 1000)
    np.testing.assert_allclose(uv[capture.topology.faces[1]], [[0.9, 0.9], [0.6, 0.9], [0.9, 0.6]])


def test_a_camera_may_miss_a_frame(original: Path) -> None:
    (original / "images" / SEGMENTS[1] / "left" / "000002.png").unlink()
    shutil.rmtree(original / "images" / SEGMENTS[2] / "right")
    capture = Capture.open(original)
    frames = {(f.segment, f.name): f for f in capture.frames}
    assert capture.cameras_of(frames[SEGMENTS[0], "000000"]) == ("front", "left", "right")
    assert capture.cameras_of(frames[SEGMENTS[1], "000002"]) == ("front", "right")
    assert capture.cameras_of(frames[SEGMENTS[2], "000000"]) == ("front", "left")


def test_bad_frames_are_left_out_and_told_of_once(
    original: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mesh = original / "tracked_mesh" / SEGMENTS[0]
    (mesh / "000000.bin").unlink()
    (mesh / "000001.bin").write_bytes(b"\0" * 40)
    (mesh / "000002_transform.txt").unlink()

    with caplog.at_level(logging.WARNING):
        capture = Capture.open(original)

    assert len(capture.frames) == 9
    assert len(capture.left_out) == 3
    assert "3 of 12 frames are left out" in caplog.text
    assert "40 bytes; 4 vertices need 48" in capture.left_out[1]


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("frame_list.txt", "one two three\n", r"frame_list.txt:1: .* is not SEGMENT FRAME"),
        ("frame_list.txt", "../x 000000\n", r"frame_list.txt:1: .* is not SEGMENT FRAME"),
        ("frame_list.txt", "", "frame_list.txt: no frames"),
        ("KRT", "front\n1 2\n", r"KRT: camera front: 9 numbers of K"),
    ],
)
def test_a_bad_describing_file_is_named(original: Path, file: str, text: str, message: str) -> None:
    (original / file).write_text(text)
    with pytest.raises(CaptureError, match=message):
        Capture.open(original)


def test_lens_distortion_is_told_of(original: Path, caplog: pytest.LogCaptureFixture) -> None:
    text = (original / "KRT").read_text().replace("0 0 0 0 0", "0.1 0 0 0 0", 1)
    (original / "KRT").write_text(text)
    with caplog.at_level(logging.WARNING):
        Capture.open(original)
    assert "camera front states lens distortion" in caplog.text


def test_an_obj_that_points_nowhere_is_named(original: Path) -> None:
    path = original / "tracked_mesh" / SEGMENTS[0] / "000000.obj"
    path.write_text("v 0 0 0\nvt 0 0\nf 1/1 2/1 1/1\n")
    with pytest.raises(CaptureError, match=r"000000\.obj: triangles of 1 vertices"):
        Capture.open(original)
