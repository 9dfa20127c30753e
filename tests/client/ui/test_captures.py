"""Pictures and recordings by key: each under a new name, and no disk can end a call."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pica_client.errors import OptionError
from pica_client.ui.recorder import Captures, new_path

pytestmark = pytest.mark.unit

GREY = np.full((48, 64, 3), 90, np.uint8)


def test_pictures_count_up_and_overwrite_nothing(tmp_path: Path) -> None:
    (tmp_path / "picture-0002.png").write_text("mine")
    captures = Captures(tmp_path)
    said = [captures.save_picture(GREY) for _ in range(2)]
    assert said[0].startswith("Saved picture-0001.png")
    assert said[1].startswith("Saved picture-0003.png")
    assert (tmp_path / "picture-0002.png").read_text() == "mine"
    with Image.open(tmp_path / "picture-0003.png") as image:
        assert image.size == (64, 48)


def test_a_recording_begins_and_ends_by_the_same_key_also_one_that_has_a_name(
    tmp_path: Path,
) -> None:
    av = pytest.importorskip("av")
    folder = tmp_path / "calls" / "of today"
    captures = Captures(folder)
    assert not folder.exists()
    captures.record(tmp_path / "call.mp4", (64, 48))
    said = []
    for pressed in range(3):
        for step in range(4):
            captures.write(GREY, 100.0 + pressed + 0.1 * step)
        said.append(captures.toggle_recording((64, 48)))
    names = [line.split()[-1 if "into" in line else 1] for line in said]
    assert names == ["call.mp4", "recording-0001.mp4", "recording-0001.mp4"]
    assert captures.path is None
    for path in (folder / "recording-0001.mp4", tmp_path / "call.mp4"):
        with av.open(str(path)) as container:
            assert sum(1 for _ in container.decode(video=0)) == 4


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OptionError, match="cannot be made"):
        new_path(tmp_path / "file", "picture", ".png")
