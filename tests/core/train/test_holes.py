"""What is measured of a capture whose held-out frames have holes."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from helpers.published_capture import write_published
from helpers.small_capture import render_capture
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.dataset.multiface import mesh_path
from pica_core.capture.stage.synth import RenderOptions
from pica_core.train.config import PRESETS
from pica_core.train.data.training import TrainingData
from pica_core.train.evaluate import evaluate, successor
from pica_core.train.train import open_trainer

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]

STAGE = RenderOptions(
    frames=20,
    cameras=2,
    size="64x64",
    texture_size=64,
    tracked_vertices=400,
)
CONFIG = replace(PRESETS["tiny"], texture_size=64)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures") / "whole"
    render_capture(STAGE, folder)
    return folder


@pytest.fixture
def capture(whole: Path, tmp_path: Path) -> Path:
    """A copy to damage."""
    return shutil.copytree(whole, tmp_path / "capture")


def held_out_images(capture: Path, view: str) -> list[Path]:
    frames = Capture.open(capture).frames_of("test")
    return [capture / "images" / f.segment / view / f"{f.name}.png" for f in frames]


def test_an_image_that_cannot_be_read_is_left_out_and_counted(
    capture: Path, tmp_path: Path
) -> None:
    front = held_out_images(capture, "front")
    front[0].write_bytes(b"no image")
    nothing = dict.fromkeys(("geometry_steps", "joint_steps", "driver_steps"), 0)
    config = replace(CONFIG, **nothing)
    with open_trainer(TrainingData(Capture.open(capture)), config, tmp_path) as trainer:
        rows = {(row["source"], row["view"]): row for row in evaluate(trainer)}

    for source in ("encoder", "driver"):
        damaged, whole = rows[source, "front"], rows[source, "left"]
        assert (damaged["frames"], damaged["unreadable"]) == (len(front) - 1, 1)
        assert (whole["frames"], whole["unreadable"]) == (len(front), 0)
        assert damaged["mse"] > 0


def test_the_change_does_not_span_a_frame_that_is_left_out(tmp_path: Path) -> None:
    capture = write_published(tmp_path / "m--0001", frames=4)
    before = TrainingData(Capture.open(capture))
    first, second, *_ = before.test_frames
    where = before.capture.frames[second]
    (capture / mesh_path(where.segment, where.name)).unlink()

    data = TrainingData(Capture.open(capture))

    first, second, third = data.test_frames
    assert successor(before, first) == second
    assert successor(data, first) is None
    assert successor(data, second) == third
