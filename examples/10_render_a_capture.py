"""Render a tiny capture of a person of the face model: what a camera dome would record.

You learn what training reads: images of several calibrated cameras, a tracked mesh and an
average texture per frame, depth, and the expression of each frame.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.person.choices import draw_person
from pica_core.capture.person.subject import PersonSubject
from pica_core.capture.stage.synth import RenderOptions, render_subject

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
OUT.mkdir(parents=True, exist_ok=True)
OPTIONS = RenderOptions(frames=6, cameras=2, size="128x128", texture_size=64, tracked_vertices=1000)


def make_subject() -> PersonSubject:
    """Put person number 7 on the stage, on a coarse mesh and without shadows: seconds count."""
    return PersonSubject(draw_person(7), bake_size=256, self_shadow=False, coarse=True)


with tempfile.TemporaryDirectory() as folder:
    counts = render_subject(make_subject, OPTIONS, Path(folder))
    capture = Capture.open(Path(folder))
    print(f"{counts['images']} images by {len(capture.cameras)} cameras")
    for split in ("train", "test"):
        print(f"{split}: {len(capture.frames_of(split))} frames")
    frame = capture.frames[1]
    shown = [capture.image(frame, name) for name in capture.cameras_of(frame)]
    Image.fromarray(np.concatenate(shown, axis=1)).save(OUT / "capture.png")
