"""The stage, the files it writes, and the reader of those files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.small_capture import TINY, render_capture, small_head
from pica_command.main import main
from pica_core.camera import dome_cameras
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.dataset.files import BackgroundWriter
from pica_core.capture.stage.synth import RenderOptions
from pica_core.errors import CaptureError

pytestmark = pytest.mark.render


def files_of(root: Path) -> dict[str, bytes]:
    return {
        str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()
    }


def test_a_dome_of_one_lens_looks_at_the_head_from_all_its_cameras() -> None:
    cameras = dome_cameras(40, 1334, 2048, "one")
    assert [camera.name for camera in cameras[:5]] == ["front", "left", "right", "up", "down"]
    assert len({camera.name for camera in cameras}) == 40
    assert len({float(camera.intrinsics[0, 0]) for camera in cameras}) == 1
    for camera in cameras:
        pixels, distance = camera.project(np.array([[0.0, 0.0, 0.02]]))
        assert np.abs(pixels - [667, 1024]).max() < 80
        assert 0.9 < distance[0] < 1.1
    apart = [np.delete(cameras, k) for k in range(40)]
    for camera, others in zip(cameras, apart, strict=True):
        assert min(np.linalg.norm(camera.centre_m - c.centre_m) for c in others) > 0.03
    with pytest.raises(CaptureError, match="lenses is 'two'; there are mixed, one"):
        RenderOptions(lenses="two")


def test_a_capture_reads_back_what_the_stage_rendered(rendered: Path) -> None:
    capture = Capture.open(rendered)
    head = small_head()
    assert len(capture.frames) == 5
    assert {frame.split for frame in capture.frames} == {"train", "test"}
    frame = capture.frames_of("test")[0]
    np.testing.assert_allclose(
        capture.true_vertices_m(frame), head.vertices(frame.arkit), atol=2e-6
    )
    np.testing.assert_array_equal(capture.topology.faces, head.chart.faces)
    assert capture.image(frame, "front").shape == (64, 64, 3)
    depth = capture.depth_m(frame, "front")
    assert 0.8 < depth[depth > 0].min() < depth.max() < 1.3
    assert capture.average_texture(frame)[:40].mean() > capture.average_texture(frame)[44:].mean()
    pose = capture.head_to_world(frame)
    np.testing.assert_allclose(pose[:, :3] @ pose[:, :3].T, np.eye(3), atol=1e-12)
    assert 0.001 < np.abs(pose - np.eye(3, 4)).max() < 0.2


def test_the_same_seed_gives_the_same_bytes_also_in_an_interrupted_render(
    rendered: Path, tmp_path: Path
) -> None:
    class Interrupted(Exception):
        pass

    def stop(done: int, _total: int) -> None:
        if done == 2:
            raise Interrupted

    out = tmp_path / "half"
    with pytest.raises(Interrupted):
        render_capture(TINY, out, stop)
    with pytest.raises(CaptureError, match="not finished"):
        Capture.open(out)
    assert render_capture(TINY, out)["resumed"] == 2
    assert files_of(out) == files_of(rendered)


def test_two_processes_render_folds_to_the_same_bytes_as_one(tmp_path: Path) -> None:
    folds = replace(TINY, folds=True)
    assert render_capture(folds, tmp_path / "one")["resumed"] == 0
    render_capture(replace(folds, workers=2), tmp_path / "two")
    assert files_of(tmp_path / "one") == files_of(tmp_path / "two")


def test_a_render_into_a_used_directory_is_refused(rendered: Path) -> None:
    with pytest.raises(CaptureError, match=r"not empty.*name another directory"):
        render_capture(TINY, rendered)


def test_a_render_that_cannot_begin_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine")
    assert main(["capture", "person", "--out", str(tmp_path / "file")]) == 2
    message = f"{tmp_path / 'file'}: is no directory; name one to make"
    assert capsys.readouterr().err.endswith(f"pica capture person: {message}\n")
    assert files_of(tmp_path) == {"file": b"mine"}


def test_an_image_that_cannot_be_written_ends_the_render(tmp_path: Path) -> None:
    (tmp_path / "images").write_text("in the way")
    picture = np.zeros((4, 4, 3), np.uint8)
    with BackgroundWriter() as writer:
        writer.image(tmp_path / "images" / "SEG" / "0.png", lambda: picture)
        with pytest.raises(CaptureError, match=r"0\.png: cannot write \(Not a directory\)"):
            writer.finish()
    assert sorted(tmp_path.iterdir()) == [tmp_path / "images"]
