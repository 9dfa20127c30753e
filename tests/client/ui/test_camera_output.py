"""The picture of the call as a camera, tested with files in its place."""

import os
import threading
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from pica_client.errors import OptionError
from pica_client.ui.camera_output import CameraOutput, packed

pytestmark = pytest.mark.unit

COLOURS = np.array([[[0, 0, 0], [255, 255, 255]], [[255, 0, 0], [255, 0, 0]]], np.uint8)


def test_colours_are_those_of_a_camera() -> None:
    assert packed(COLOURS).tolist() == [[[16, 128], [235, 128]], [[82, 90], [82, 240]]]


def test_a_pipe_gets_whole_frames_of_one_size(tmp_path: Path) -> None:
    path, got = tmp_path / "pipe", []
    os.mkfifo(path)
    reader = threading.Thread(target=lambda: got.append(path.read_bytes()))
    reader.start()
    with closing(CameraOutput(path, (641, 480))) as camera:
        camera.write(np.zeros((480, 641, 4), np.uint8))
        camera.write(np.full((300, 500, 4), 255, np.uint8)[::-1])
    reader.join(timeout=20)
    frames = np.frombuffer(got[0], np.uint8).reshape(2, 480, 640, 2)
    assert (frames[0] == [16, 128]).all()
    assert (frames[1] == [235, 128]).all()


@pytest.mark.parametrize("path", ["/nowhere/video9", "/dev/null"])
def test_what_is_no_camera_is_one_line(path: str) -> None:
    with pytest.raises(OptionError, match=rf"camera {path}: .*; is v4l2loopback loaded\?"):
        CameraOutput(Path(path), (640, 480))
