"""What tests of training share."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from helpers.small_capture import render_capture
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.stage.synth import RenderOptions
from pica_core.train.data import TrainingData


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """Torch on one thread while a module trains: its sums are the same in every run."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def captured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture that tests of training share, to be read alone."""
    folder = tmp_path_factory.mktemp("captures") / "someone"
    render_capture(RenderOptions(frames=20, cameras=2, size="128x128", texture_size=64), folder)
    return folder


@pytest.fixture(scope="module")
def data(captured: Path) -> TrainingData:
    """The same as training reads it."""
    return TrainingData(Capture.open(captured))
