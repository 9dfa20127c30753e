"""The same bytes from every process, however many threads the matrix library has."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar
from pica_core.capture.stage.expressions import sentence

pytestmark = pytest.mark.unit

HASHES = """
import hashlib, sys
import numpy as np
from pica_core.avatar.file import load_avatar
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder, StreamConfig

profile = load_avatar(sys.argv[1]).stream_profile()
for config in (StreamConfig(quality=0), StreamConfig(quality=7), StreamConfig()):
    encoder, decoder = LatentEncoder(profile, config), LatentDecoder(profile)
    digest = hashlib.sha256()
    for index, latent in enumerate(np.load(sys.argv[2])):
        nod = abs(index % 64 - 32) / 512
        pose, captured_us = ((nod, -nod / 2, nod / 4), (nod / 16, 0.0, -nod / 8)), index * 33_333
        frame = encoder.encode(latent, *pose, captured_us)
        shown = decoder.decode(frame.payload)
        digest.update(frame.payload)
        for array in (shown.latent, shown.rotation, shown.translation_m):
            digest.update(array.astype("<f4").tobytes())
    print(digest.hexdigest())
"""
AVATAR = Path(str(resources.files("pica_core"))) / "avatars" / "amara.pica"


def coded(threads: int, latents: Path) -> list[str]:
    """What a fresh process makes of faces from a file."""
    libraries = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    environment = {**os.environ, **dict.fromkeys(libraries, str(threads))}
    command = [sys.executable, "-c", HASHES, str(AVATAR), str(latents)]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return done.stdout.splitlines()


def test_a_shipped_avatars_performance_is_the_same_bytes_in_every_process(tmp_path: Path) -> None:
    encoder = ExpressionEncoder(load_avatar(AVATAR))
    faces = sentence(np.random.default_rng(5), 150)
    np.save(tmp_path / "talk.npy", np.stack([encoder.encode(face) for face in faces]))
    one, two = coded(1, tmp_path / "talk.npy"), coded(2, tmp_path / "talk.npy")
    assert one == two
    assert len(set(one)) == 3
