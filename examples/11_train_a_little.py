"""Train for a few steps on a tiny capture and export an avatar file.

You learn the order of training: first the geometry, then everything jointly, then the encoder
that turns ARKit values into latents. So few steps make no likeness; `pica train` does the same
for longer.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import torch

from pica_core.avatar.file import avatar_id, save_avatar
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.person.choices import draw_person
from pica_core.capture.person.subject import PersonSubject
from pica_core.capture.stage.synth import RenderOptions, render_subject
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.train.config import PRESETS
from pica_core.train.data import TrainingData
from pica_core.train.export import make_avatar
from pica_core.train.train import open_trainer

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
OUT.mkdir(parents=True, exist_ok=True)
STAGE = RenderOptions(frames=6, cameras=2, size="64x64", texture_size=64, tracked_vertices=1000)
CONFIG = replace(PRESETS["tiny"], geometry_steps=3, joint_steps=3, driver_steps=3)


def make_subject() -> PersonSubject:
    """Put person number 7 on the stage, on a coarse mesh and without shadows: seconds count."""
    return PersonSubject(draw_person(7), bake_size=256, self_shadow=False, coarse=True)


def show(step: int, phase: str, losses: dict[str, float]) -> bool:
    """Print a step's losses; True goes on."""
    print(f"{step:3d} {phase:9} " + "  ".join(f"{n} {v:.4f}" for n, v in losses.items()))
    return True


torch.set_num_threads(1)
with tempfile.TemporaryDirectory() as folder:
    render_subject(make_subject, STAGE, Path(folder, "capture"))
    data = TrainingData(Capture.open(Path(folder, "capture")))
    with open_trainer(data, CONFIG, Path(folder, "run")) as trainer:
        trainer.run(show)
        assert isinstance(trainer.model, PixelCodecAvatar)
        avatar = make_avatar(
            trainer.model, data, name="Toy", identity="P7", licence="Apache-2.0", model_card={}
        )
file = OUT / "toy.pica"
save_avatar(file, avatar)
print(f"{file.name}: {file.stat().st_size / 1e6:.2f} MB, {avatar_id(file)[:8]}")
