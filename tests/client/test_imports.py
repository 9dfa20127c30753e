"""The client stands without torch, and a sender without what only a viewer needs."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.unit

IMPORT_ALL = """
import importlib, pkgutil, sys
for name in {blocked!r}:
    sys.modules[name] = None  # any import of it fails from now on
import pica_client
found = [module.name for module in pkgutil.walk_packages(pica_client.__path__, "pica_client.")]
for name in {wanted!r} or found:
    importlib.import_module(name)
print(len(found))
"""


def import_with_blocked(blocked: list[str], wanted: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", IMPORT_ALL.format(blocked=blocked, wanted=wanted)],
        capture_output=True,
        text=True,
        check=False,
    )


def test_every_module_of_the_client_imports_without_torch() -> None:
    done = import_with_blocked(["torch", "pica_server"], [])
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) >= 30


def test_a_sender_imports_without_graphics_and_inference() -> None:
    blocked = ["torch", "moderngl", "glfw", "onnx", "onnxruntime", "PIL", "av", "cryptography"]
    wanted = [
        "pica_client.cli.send",
        "pica_client.cli.view",
        "pica_client.endpoint",
        "pica_client.call.call",
        "pica_client.cli.demo",
    ]
    done = import_with_blocked(blocked, wanted)
    assert done.returncode == 0, done.stderr
