"""The same bytes from every process, however many threads the matrix library has."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from helpers.paths import ROOT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar
from pica_core.capture.stage.expressions import sentence

pytestmark = pytest.mark.unit

SCRIPT = ROOT / "scripts" / "bit_exact.py"
AVATAR = Path(str(resources.files("pica_core"))) / "avatars" / "amara.pica"


def coded(threads: int, *arguments: str) -> list[str]:
    """What a fresh process makes of faces from a file."""
    libraries = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    environment = {**os.environ, **dict.fromkeys(libraries, str(threads))}
    command = [sys.executable, str(SCRIPT), *arguments]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return done.stdout.splitlines()


def test_a_shipped_avatars_performance_is_the_same_bytes_in_every_process(tmp_path: Path) -> None:
    encoder = ExpressionEncoder(load_avatar(AVATAR))
    faces = sentence(np.random.default_rng(5), 150)
    np.save(tmp_path / "talk.npy", np.stack([encoder.encode(face) for face in faces]))
    options = ("--avatar", str(AVATAR), "--latents", str(tmp_path / "talk.npy"))
    one, two = coded(1, *options), coded(2, *options)
    assert one == two
    assert len(set(one)) == 5  # the versions, and four ways of coding that differ
