"""The page's modules in a Node process, which tests call as if they were Python's."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.paths import ROOT

PEER = ROOT / "tests" / "web" / "peer.mjs"


def node_module(path: str) -> Path:
    """A file of the packages that tests of the page need; skips the test where npm cannot get
    them."""
    folder = PEER.parent
    found = folder / "node_modules" / path
    if not found.exists():
        npm = shutil.which("npm")
        install = ["install", "--no-package-lock", "--no-audit", "--no-fund", "--silent"]
        if (
            npm is None
            or subprocess.run([npm, *install], cwd=folder, check=False, timeout=60).returncode
        ):
            pytest.skip("npm is not installed, or cannot install packages here")
    return found


class PageError(Exception):
    """What a module of the page has thrown: its class and its text."""


class Handle:
    """An object that lives in Node; its methods are called there."""

    def __init__(self, page: "Page", number: int) -> None:
        self._page = page
        self.number = number

    def __getattr__(self, name: str) -> Any:
        return lambda *args: self._page.ask({"object": self.number}, name, args)


class Page:
    """Calls functions of the page's modules."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process

    def call(self, module: str, name: str, *args: Any) -> Any:
        """Call a function of a module, or make an object of a class; or return a constant."""
        return self.ask(f"{module}.js", name, args)

    def ask(self, target: Any, name: str, args: Any) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([target, name, _sent(args)]) + "\n")
        self._process.stdin.flush()
        answer = json.loads(self._process.stdout.readline())
        if "error" in answer:
            raise PageError(answer["error"])
        return self._received(answer["value"])

    def _received(self, value: Any) -> Any:
        if isinstance(value, list):
            return [self._received(each) for each in value]
        if not isinstance(value, dict):
            return value
        if set(value) == {"hex"}:
            return bytes.fromhex(value["hex"])
        if set(value) == {"object"}:
            return Handle(self, value["object"])
        return {key: self._received(each) for key, each in value.items()}


def _sent(value: Any) -> Any:
    if isinstance(value, bytes):
        return {"hex": value.hex()}
    if isinstance(value, Handle):
        return {"object": value.number}
    if isinstance(value, np.ndarray) and value.dtype == np.float32:
        return {"f32": value.ravel().tolist()}
    if isinstance(value, np.ndarray):
        return value.ravel().tolist()
    if isinstance(value, (list, tuple)):
        return [_sent(each) for each in value]
    if isinstance(value, dict):
        return {key: _sent(each) for key, each in value.items()}
    return value
