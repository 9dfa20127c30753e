"""A sender stands without what only a viewer needs."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.unit

IMPORT = """
import importlib, sys
for name in "torch moderngl glfw onnx onnxruntime PIL av cryptography".split():
    sys.modules[name] = None  # any import of it fails from now on
for name in "cli.send cli.view cli.demo endpoint call.call".split():
    importlib.import_module(f"pica_client.{name}")
"""


def test_a_sender_imports_without_graphics_and_inference() -> None:
    subprocess.run([sys.executable, "-c", IMPORT], check=True)
