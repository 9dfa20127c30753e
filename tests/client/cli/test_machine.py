"""What the doctor says of a bare machine, and what a command says whose extra is missing."""

import importlib
import json
import subprocess
import sys
from typing import Any

import pytest

from pica_client.cli.machine import examine
from pica_command.table import COMMANDS, install_line, modules_by_extra
from pica_core.errors import GraphicsError

pytestmark = [pytest.mark.unit, pytest.mark.slow]

EXTRAS = {name for name, modules in modules_by_extra().items() if modules} - {"all"}

BASE_INSTALL = """
import importlib.abc, json, sys
blocked = set(sys.argv[1].split(","))

class Missing(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in blocked:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
from pica_command.main import main
for words in json.loads(sys.argv[2]):
    print("status", main(words), flush=True)
"""


def run_on_the_base_install(*commands: list[str]) -> tuple[list[str], str]:
    """Run commands where no module of any extra can be imported."""
    blocked = {module for modules in modules_by_extra().values() for module in modules}
    assert {"numpy", "moderngl", "torch", "av", "cryptography", "nats"} <= blocked
    done = subprocess.run(
        [sys.executable, "-c", BASE_INSTALL, ",".join(blocked), json.dumps(commands)],
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.splitlines(), done.stderr


def test_the_doctor_runs_on_the_base_install_and_names_every_extra() -> None:
    out, said = run_on_the_base_install(["doctor"])
    assert out == ["status 0"]
    for extra in EXTRAS:
        assert f"missing  extra {extra}: no " in said
        assert f"; to fix it: {install_line(extra)}\n" in said
    assert "missing  OpenGL: moderngl is not installed" in said


def test_on_the_base_install_every_command_names_the_extra_that_it_needs() -> None:
    needy = [name for name, row in COMMANDS.items() if row.extras]
    assert {"view", "send", "demo", "train", "bench call"} <= set(needy)
    out, said = run_on_the_base_install(*(name.split() for name in needy))
    lines = said.splitlines()
    assert dict(zip(needy, out, strict=True)) == dict.fromkeys(needy, "status 2")
    for name, line in zip(needy, lines, strict=True):
        extra = COMMANDS[name].extras[0]
        assert line.startswith(f"pica {name}: needs ")
        assert line.endswith(f"; install it with: {install_line(extra)}")


class BrokenGraphics:
    @staticmethod
    def create_context() -> None:
        raise GraphicsError("no context; install libegl1")


def load(name: str) -> Any:
    """Import as on a machine whose graphics driver is broken and whose sound server, to which that
    library connects at once, is away."""
    if name == "pica_core.gl":
        return BrokenGraphics
    if name == "soundcard":
        raise AssertionError
    if name in ("moderngl", "torch", "livekit"):
        raise ModuleNotFoundError(name=name)
    return importlib.import_module(name)


def test_the_doctor_names_the_fix_for_each_lack() -> None:
    findings = {finding.subject: finding for finding in examine(load, has_display=False)}
    assert findings["extra send"].level == "ready"
    assert findings["extra view"].fix == install_line("view")
    assert "moderngl" in findings["extra view"].detail
    assert findings["OpenGL"].detail == "no context; install libegl1"
    assert findings["display"].level == "missing"
    assert findings["CUDA"].fix == install_line("train")
    assert findings["extra train"].line.startswith("missing  extra train: no moderngl, torch; to")
    assert findings["extra echo"].detail == "no livekit"
    assert findings["extra voice"].detail == "installed, but no sound system answers"
    assert findings["extra voice"].fix == "start PulseAudio or PipeWire"
