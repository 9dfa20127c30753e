"""ONNX Runtime has one door, and its telemetry is off behind it."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator

import pytest

from helpers.paths import ROOT

pytestmark = pytest.mark.unit

DOOR = ROOT / "client/pica_client/decode/onnx_runtime.py"
FOLDERS = (
    *("client", "command", "examples", "pica_core", "protocol"),
    *("scripts", "server", "tests"),
)


def imports_of(source: str) -> Iterator[str]:
    """Every module that a source imports, by statement or by `importlib.import_module`."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name | ast.Attribute)
            and "import" in ast.unparse(node.func)
            and node.args
            and isinstance(node.args[0], ast.Constant)
        ):
            yield str(node.args[0].value)


def test_nothing_imports_the_runtime_but_its_door() -> None:
    paths = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
    sources = {path: path.read_text() for path in paths}
    guilty = [
        path
        for path, source in sources.items()
        if "onnxruntime" in source
        and any(name.split(".")[0] == "onnxruntime" for name in imports_of(source))
    ]
    assert guilty == [DOOR]


@pytest.mark.parametrize(
    "source",
    [
        "import onnxruntime",
        "from onnxruntime import InferenceSession",
        "import onnxruntime.capi as capi",
        "importlib.import_module('onnxruntime')",
        "pytest.importorskip('onnxruntime')",
        "def f():\n    import onnxruntime",
    ],
)
def test_an_import_is_found_however_it_is_written(source: str) -> None:
    assert "onnxruntime" in {name.split(".")[0] for name in imports_of(source)}


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
