"""From an Ava-256 directory to an avatar that talks, where the truth is known."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.ava_capture import write_ava
from helpers.face_networks import face_networks
from helpers.small_capture import render_capture
from pica_client.decode.decoder import OnnxDecoder
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar
from pica_core.capture.dataset.check import check_capture
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.stage.synth import RenderOptions
from pica_core.errors import CaptureError
from pica_core.train.cli.train import ExportOptions, TrainOptions, export, train
from pica_core.train.config import PRESETS
from pica_core.train.data import ImageCache

pytestmark = pytest.mark.train

OPTIONS = RenderOptions(
    frames=12, cameras=2, size="64x64", texture_size=256, seed=5, tracked_vertices=2500
)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("source") / "someone"
    render_capture(OPTIONS, folder)
    return Capture.open(folder)


@pytest.fixture(scope="module")
def dome(source: Capture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_ava(source, tmp_path_factory.mktemp("ava") / "20210810--1306--ABC123")


@pytest.mark.slow
def test_a_dome_becomes_an_avatar_that_talks(
    dome: Path, source: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    from pica_core.capture.me.tracked import fit_capture

    monkeypatch.setattr("pica_core.capture.me.register.FINDING", [(1.05, 0.0)])
    steps = {"geometry_steps": 0, "joint_steps": 4, "driver_steps": 2, "pixels_per_image": 256}
    small = replace(PRESETS["small"], **steps, depth=1.0)
    monkeypatch.setitem(PRESETS, "small", small)
    trained = tmp_path / "run"
    assert fit_capture(Capture.open(dome), face_networks(), lambda done, of: None) < 0.001

    capture = Capture.open(dome)
    true = np.array([frame.arkit for frame in source.frames])
    found = np.array([frame.arkit for frame in capture.frames])
    assert np.abs(found - true).mean() < 0.06 < np.abs(true).mean()
    assert np.corrcoef(found.ravel(), true.ravel())[0, 1] > 0.8
    assert capture.topology.region("lids").any()
    middle_m, true_m = (np.median(c.vertices_m(c.frames[0]), axis=0) for c in (capture, source))
    assert np.abs(middle_m - true_m).max() < 0.01
    assert check_capture(dome)["problems"] == []
    table = dome / "expressions.csv"
    whole = table.read_text()
    table.write_text(whole[: whole.rindex("\n", 0, -1) + 1])
    assert len(Capture.open(dome).frames) == 11
    assert len(Capture.open(dome, take_fit=False).frames) == 12
    table.write_text(whole)

    with caplog.at_level(logging.WARNING):
        train(TrainOptions(capture=dome, out=trained, eval_frames=1, threads=1))
    assert "no depth: depth and normal losses are off" in caplog.text
    export(ExportOptions(run=trained, capture=dome, out=trained / "a.pica", name="A", levels=False))
    avatar = load_avatar(trained / "a.pica")
    assert avatar.manifest.licence.startswith("CC BY-NC 4.0")
    towards = np.array([0, 0, 1], np.float32)
    speaking = np.zeros((2, NUM_ARKIT), np.float32)
    speaking[1, ARKIT_INDEX["jawOpen"]] = 0.8
    calm, open_mouth = (
        OnnxDecoder(avatar).decode(ExpressionEncoder(avatar).encode(face), towards)
        for face in speaking
    )
    assert np.abs(open_mouth.position_map - calm.position_map).max() > 0.003


def test_images_of_a_capture_ten_times_the_cache_leave_it_as_large(
    dome: Path, source: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    large = Capture.open(write_ava(source, tmp_path / "ava", copies=4))
    kept = len(large.frames) * 4 // 10  # images and masks of two cameras
    pixels = large.cameras[0].width * large.cameras[0].height
    monkeypatch.setattr("pica_core.train.data.IMAGE_CACHE_BYTES", kept * 4 * pixels)
    decoded: list[str] = []
    read = Capture.image

    def count(self: Capture, frame: object, camera: str) -> object:
        decoded.append(camera)
        return read(self, frame, camera)  # type: ignore[arg-type]

    monkeypatch.setattr(Capture, "image", count)
    images = ImageCache(large)
    every = [(k, name) for k in range(len(large.frames)) for name in images.cameras_of(k)]
    for place in every:
        images.expect([place], depth=False)
        assert images.mask(*place).shape == images.image(*place).shape[:2]
    assert len(decoded) == len(every) == 96
    images.image(*every[-1])
    assert len(decoded) == 96  # still there
    images.image(*every[0])
    assert len(decoded) == 97  # long gone


def test_a_capture_of_ours_has_its_expressions(source: Capture) -> None:
    from pica_core.cli import ExpressionsOptions, expressions

    with pytest.raises(CaptureError, match="has its expressions"):
        expressions(ExpressionsOptions(capture=source.path))
