"""Each example runs, says something, warns of nothing and leaves its files where it is told."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.paths import ROOT

pytestmark = pytest.mark.train

EXAMPLES = sorted((ROOT / "examples").glob("[0-9]*.py"))
FILES = {
    "03_avatar_to_png": ["amara-rest.png", "amara-smile.png"],
    "04_draw_a_head": ["two-heads.png"],
    "10_render_a_capture": ["capture.png"],
    "11_train_a_little": ["toy.pica"],
    "12_look_into_an_avatar_file": ["renamed.pica"],
    "13_import_a_rig": ["rig.png"],
    "22_a_recording_with_sound": ["flash.mp4"],
    "23_embed_a_receiver": ["two-eyes.png"],
}
"""What each example writes into the folder that it is given; the others write nothing."""
LIVE = ("01", "02", "07", "14", "18", "19", "20", "21", "22", "23", "25")
"""Numbers of the examples that hold a call or follow a clock."""
PATIENCE_S = 120.0
"""On a loaded machine; alone, the longest takes eight seconds."""


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(
            path, id=path.stem, marks=pytest.mark.realtime if path.stem[:2] in LIVE else ()
        )
        for path in EXAMPLES
    ],
)
def test_an_example_runs_without_a_warning(example: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = subprocess.run(
        [sys.executable, "-W", "error", str(example), str(out)],
        cwd=tmp_path,
        env=os.environ | {"LP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert done.stderr == ""
    written = sorted(path.name for path in tmp_path.rglob("*") if path.is_file())
    assert written == FILES.get(example.stem, [])
    assert all((out / name).stat().st_size > 0 for name in written)
