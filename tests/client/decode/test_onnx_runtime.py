"""ONNX Runtime's telemetry is off behind the one module that imports it (`pyproject.toml` keeps it
the only one)."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(("given", "expected"), [(None, "1"), ("0", "0"), ("1", "1")])
def test_the_door_turns_the_telemetry_off_unless_the_user_has_said_otherwise(
    given: str | None, expected: str
) -> None:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("ORT_")}
    if given is not None:
        environment["ORT_DISABLE_TELEMETRY"] = given
    # A stand-in for the library: with telemetry on, the real one would reach for the network.
    script = (
        "import os, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'onnxruntime':\n"
        "            print(os.environ.get('ORT_DISABLE_TELEMETRY'))\n"
        "            raise ModuleNotFoundError(name)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "try:\n"
        "    import pica_client.decode.onnx_runtime\n"
        "except ModuleNotFoundError:\n"
        "    pass\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [expected]
