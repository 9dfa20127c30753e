"""Pictures and recordings by key: each under a new name, and no disk can end a call."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pica_client.errors import OptionError
from pica_client.ui.captures_on_disk import CapturesOnDisk, new_path

pytestmark = pytest.mark.unit

GREY = np.full((48, 64, 3), 90, np.uint8)


def test_pictures_count_up_and_overwrite_nothing(tmp_path: Path) -> None:
    (tmp_path / "picture-0002.png").write_text("mine")
    with CapturesOnDisk(tmp_path) as captures:
        said = [captures.save_picture(GREY) for _ in range(2)]
    assert said[0].startswith("Saved picture-0001.png")
    assert said[1].startswith("Saved picture-0003.png")
    assert (tmp_path / "picture-0002.png").read_text() == "mine"
    with Image.open(tmp_path / "picture-0003.png") as image:
        assert image.size == (64, 48)


def test_the_folder_is_made_when_it_is_needed(tmp_path: Path) -> None:
    folder = tmp_path / "calls" / "of today"
    with CapturesOnDisk(folder) as captures:
        assert not folder.exists()
        captures.save_picture(GREY)
    assert (folder / "picture-0001.png").exists()


def test_a_recording_begins_and_ends_by_the_same_key(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    with CapturesOnDisk(tmp_path) as captures:
        assert captures.toggle_recording((64, 48)) == "Recording into recording-0001.mp4"
        assert captures.is_recording
        for step in range(4):
            captures.write(GREY, 100.0 + 0.1 * step)
        assert captures.toggle_recording((64, 48)).startswith("Saved recording-0001.mp4")
        assert not captures.is_recording
    with av.open(str(tmp_path / "recording-0001.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) == 4


def test_a_recording_under_way_is_finished_at_the_end(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    with CapturesOnDisk(tmp_path) as captures:
        captures.toggle_recording((64, 48))
        captures.write(GREY, 0.0)
    with av.open(str(tmp_path / "recording-0001.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) == 1


def test_without_a_recording_frames_go_nowhere(tmp_path: Path) -> None:
    with CapturesOnDisk(tmp_path) as captures:
        assert captures.write(GREY, 0.0) == ""
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OptionError, match="cannot be made"):
        new_path(tmp_path / "file", "picture", ".png")
