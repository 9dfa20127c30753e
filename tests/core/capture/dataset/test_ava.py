"""Ava-256 directories: read as they are, with holes, and damaged; and films that are no capture."""

import json
import logging
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from helpers.ava_capture import SHIFT_M, TURN, narrow, resampled_m, write_ava
from pica_core.capture.dataset.check import check_capture
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.dataset.files import ply_points
from pica_core.capture.dataset.members import Member, read_members
from pica_core.errors import CaptureError

pytestmark = pytest.mark.unit

IMAGES, MESHES = Path("decoder/image"), Path("decoder/kinematic_tracking/registration_vertices.zip")


@pytest.fixture(scope="session")
def source(rendered: Path) -> Capture:
    return Capture.open(rendered)


@pytest.fixture(scope="session")
def written(source: Capture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_ava(source, tmp_path_factory.mktemp("ava") / "20210810--1306--ABC123")


@pytest.fixture
def dome(written: Path, tmp_path: Path) -> Path:
    """A copy that may be damaged."""
    return Path(shutil.copytree(written, tmp_path / written.name))


def drop(path: Path, member: str) -> None:
    """Take a member out of a zip file."""
    with zipfile.ZipFile(path) as opened:
        kept = {name: opened.read(name) for name in opened.namelist() if member not in name}
    with zipfile.ZipFile(path, "w") as opened:
        for name, data in kept.items():
            opened.writestr(name, data)


def test_a_directory_is_read_as_it_is(written: Path, source: Capture) -> None:
    capture = Capture.open(written)
    assert (capture.is_published, capture.has_depth, capture.has_masks) == (True, False, True)
    assert capture.identity == written.name
    assert [frame.name for frame in capture.frames] == [f"{7 + 3 * k:06d}" for k in range(5)]
    assert {f.segment for f in capture.frames_of("test")} == {"EXP_free_face"}
    frame, original = capture.frames[2], source.frames[2]
    mesh_m = resampled_m(source, original) @ TURN.T + SHIFT_M
    found = capture.vertices_m(frame)[capture.topology.faces]
    np.testing.assert_allclose(found, mesh_m[source.tracked_topology.faces], atol=1e-6)
    for camera, true in zip(capture.cameras, source.cameras, strict=True):
        shown = narrow(true)
        pixels = capture.head_camera(frame, camera.name).project(mesh_m)[0] + [shown.start, 0]
        seen = source.head_camera(original, true.name)
        np.testing.assert_allclose(pixels, seen.project((mesh_m - SHIFT_M) @ TURN)[0], atol=1e-6)
        image = np.float32(source.image(original, true.name)[:, shown])
        assert np.abs(image - capture.image(frame, camera.name)).mean() < 6
        person = source.depth_m(original, true.name)[:, shown] > 0
        person[-4:] = False
        np.testing.assert_array_equal(capture.mask(frame, camera.name), person)
    texture = np.float32(capture.average_texture(frame)) - source.average_texture(original)
    assert np.abs(texture).mean() < 6


def test_what_is_not_there_is_counted_and_the_rest_is_read(
    dome: Path, caplog: pytest.LogCaptureFixture
) -> None:
    calibration = dome / "decoder" / "camera_calibration.json"
    cameras = json.loads(calibration.read_text())
    for name in ("401000", "401001"):
        cameras["KRT"].append({**cameras["KRT"][0], "cameraId": name, "distortion": [0.1, 0, 0, 0]})
    calibration.write_text(json.dumps(cameras))
    (dome / IMAGES / "cam401001.zip").write_bytes(b"PK\3\4 and no more")
    drop(dome / IMAGES / "cam400001.zip", "000010")
    drop(dome / MESHES, "000013")
    shutil.rmtree(dome / "decoder" / "segmentation_parts")
    with caplog.at_level(logging.WARNING):
        capture = Capture.open(dome)
    assert capture.cameras_of(capture.frames[1]) == ("400000",)
    assert not capture.has_masks
    result = check_capture(dome)
    assert result["missing"] == {"frames": 1, "cameras": 2, "images": 1}
    assert (result["frames"], result["images"]) == (4, 7)
    assert len(result["problems"]) == 2
    for told in (
        r"cam401001\.zip: not a whole zip file \(.*\); download it again",
        r"registration_vertices\.zip/000013: No such file",
        r"no images of 2 more cameras",
        r"camera 401000 states lens distortion, as do 1 more",
    ):
        assert re.search(told, caplog.text)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-200])


def replace_text(old: str, new: str) -> Callable[[Path], None]:
    def damage(path: Path) -> None:
        path.write_text(path.read_text().replace(old, new))

    return damage


@pytest.mark.parametrize(
    ("file", "damage", "message"),
    [
        ("face_topology.obj", Path.unlink, "missing; download .* put it there or into the folder"),
        (MESHES, Path.unlink, r"registration_vertices\.zip: the file is missing; download it"),
        (MESHES, cut, r"not a whole zip file .*; download it again"),
        ("decoder/frame_list.csv", replace_text(",7", ",x"), r"csv:2: frame_id is 'x'"),
        ("decoder/camera_calibration.json", replace_text('"K"', '"L"'), r"KRT\[0\]: .* \('K'\)"),
        ("decoder/camera_calibration.json", replace_text("400001", "400000"), "is there twice"),
        ("decoder/image", shutil.rmtree, "no image to take the size of; download some"),
    ],
)
def test_what_nothing_goes_on_without_is_named_with_a_remedy(
    dome: Path, file: str, damage: Callable[[Path], None], message: str
) -> None:
    damage(dome / file)
    with pytest.raises(CaptureError, match=message):
        Capture.open(dome)


def test_members_are_found_packed_or_not_and_damage_is_named(tmp_path: Path) -> None:
    path = tmp_path / "some.zip"
    with zipfile.ZipFile(path, "w") as opened:
        opened.writestr("a/000003.txt", "three")
        opened.writestr("notes.txt", "none")
        opened.writestr("000012.txt", "twelve" * 40, zipfile.ZIP_DEFLATED)
    members = read_members(path)
    assert {k: each.read_bytes() for k, each in members.items()} == {
        "000003": b"three", "000012": b"twelve" * 40,
    }  # fmt: skip
    data = bytearray(path.read_bytes())
    data[:4] = b"none"
    path.write_bytes(data)
    with pytest.raises(CaptureError, match=r"some\.zip/000003: missing, damaged"):
        members["000003"].read_bytes()
    with pytest.raises(CaptureError, match=r"some\.zip/000004: missing, damaged"):
        Member(path, "000004").read_bytes()


HEAD = (
    "ply\nformat {} 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
)
PLACES = np.array([[1, 2, 3], [4, 5, 6]], np.float32)


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("ascii", b"1 2 3\n4 5 6\n3 0 1 1\n"),
        ("binary_little_endian", PLACES.astype("<f4").tobytes() + b"\3"),
        ("binary_big_endian", PLACES.astype(">f4").tobytes()),
    ],
)
def test_a_ply_file_of_each_kind_is_read_and_a_cut_one_named(kind: str, body: bytes) -> None:
    head = HEAD.format(kind) + "element face 1\nproperty list uchar int vertex_index\nend_header\n"
    np.testing.assert_array_equal(ply_points(Path("f"), head.encode() + body), PLACES)
    for bad in (head.encode() + body[:5], body, head.replace("float y", "list y").encode() + body):
        with pytest.raises(CaptureError, match="f: not a whole PLY file"):
            ply_points(Path("f"), bad)


def test_films_without_a_mesh_say_what_can_be_done_with_them(tmp_path: Path) -> None:
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration" / "camera_params.json").write_text("{}")
    with pytest.raises(CaptureError, match=r"without a tracked mesh .* pica capture me --photos"):
        Capture.open(tmp_path)
