"""Models that decode the same mesh go through the same geometry phase, whatever they draw on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from helpers.small_capture import render_small
from pica_core.capture.dataset.dataset import Capture
from pica_core.train.config import PRESETS
from pica_core.train.data.training import TrainingData
from pica_core.train.train import open_trainer

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]


def test_encodings_leave_the_geometry_phase_alone_bit_for_bit(tmp_path: Path) -> None:
    data = TrainingData(Capture.open(render_small(tmp_path / "capture")))
    steps = {"geometry_steps": 3, "joint_steps": 0, "driver_steps": 0}
    states = []
    for variant in ("full", "no_uv", "pe_1d", "nerf_pe"):
        config = replace(PRESETS["tiny"], **steps, variant=variant, seed=5)
        with open_trainer(data, config, tmp_path / variant) as trainer:
            trainer.run()
            states.append(trainer.model.state_dict())

    shape = [name for name in states[0] if name.startswith(("encoder.", "geometry."))]
    assert len(shape) > 20
    for state in states[1:]:
        assert all(torch.equal(state[name], states[0][name]) for name in shape)
