"""What captures are trained on, against what trackers send."""

from pathlib import Path

import numpy as np
import pytest

from helpers.paths import SHARED_DATA
from pica_command.main import main
from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES
from pica_core.capture.stage.expressions import own_take, read_own_take, sample_takes
from pica_core.errors import CaptureError
from pica_core.types import FloatArray

pytestmark = pytest.mark.render

RECORDING = SHARED_DATA / "livelink" / "range_of_motion.csv"


def trained(frames: int = 256, seed: int = 0) -> FloatArray:
    return np.concatenate([t.arkit for t in sample_takes(frames, seed) if t.split == "train"])


def test_training_moments_have_as_many_shapes_at_once_as_real_ones() -> None:
    values = trained()
    mouth = [k for name, k in ARKIT_INDEX.items() if name.startswith("mouth")]

    assert np.quantile((values > 0.3).sum(1), 0.9) >= 14  # a real recording's: 14
    assert np.quantile(values[:, mouth].sum(1), 0.9) > 4.5  # a real recording's: 5.3 with the jaw
    close = values[:, ARKIT_INDEX["mouthClose"]] - values[:, ARKIT_INDEX["jawOpen"]]
    assert close.max() <= 0.07  # as far as a real one goes
    assert values.min() >= 0
    assert values.max() <= 1.05


@pytest.mark.skipif(not RECORDING.is_file(), reason="the recording is not there")
@pytest.mark.parametrize("seed", [0, 1])
def test_few_real_moments_lie_beyond_what_is_trained_on(seed: int) -> None:
    real, highest = read_own_take(RECORDING), trained(seed=seed).max(0)

    assert (real > highest + 0.02).any(1).mean() < 0.15  # 0.45 before shapes came in crowds


def csv_of(values: FloatArray) -> str:
    header = ",".join(("Timecode", "BlendShapeCount", *ARKIT_NAMES))
    return "\n".join(
        [header, *("0:0:0:0,61," + ",".join(f"{v:.4f}" for v in row) for row in values)]
    )


def test_the_moments_of_an_own_take_that_differ_most_are_taken(tmp_path: Path) -> None:
    values = np.zeros((50, 52), np.float32)
    values[7, 3], values[20, 9], values[21, 9] = 0.9, 0.8, 0.79
    path = tmp_path / "me.csv"
    path.write_text(csv_of(values))

    take = own_take(read_own_take(path), 3)

    assert take.split == "train"
    np.testing.assert_allclose(take.arkit.max(1), [0.9, 0.8, 0.79], atol=1e-3)


def test_a_take_of_pica_track_is_read(tmp_path: Path) -> None:
    values = np.full((3, 52), 0.5, np.float32)
    values[2] = np.nan
    with (tmp_path / "me.take").open("wb") as file:
        np.savez(file, arkit=values, has_face=np.array([True, False, True]))

    np.testing.assert_array_equal(read_own_take(tmp_path / "me.take"), values[:1])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (csv_of(np.full((2, 52), np.nan, np.float32)), "no moment with a face"),
        ("time,AU01_r,AU02_r\n0,1,2\n", "lacks 54 of 54 columns"),
        ("PK\x03\x04nothing", "not a complete archive"),
    ],
)
def test_a_take_of_another_tracker_is_refused_and_nothing_is_written(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, words: str
) -> None:
    path, out = tmp_path / "other.csv", tmp_path / "out"
    path.write_text(text)

    with pytest.raises(CaptureError, match=words):
        read_own_take(path)
    code = main(["capture", "person", "--take", str(path), "--out", str(out)])

    assert code == 2
    assert "other.csv" in capsys.readouterr().err.replace("\n", "")
    assert not out.exists()
