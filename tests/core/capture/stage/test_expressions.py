"""What captures are trained on, against what trackers send."""

import numpy as np
import pytest

from helpers.paths import SHARED_DATA
from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.capture.stage.expressions import sample_takes
from pica_core.livelink import read_livelink_csv
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit

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
    real, highest = read_livelink_csv(RECORDING).arkit, trained(seed=seed).max(0)

    assert (real > highest + 0.02).any(1).mean() < 0.15  # 0.45 before shapes came in crowds
