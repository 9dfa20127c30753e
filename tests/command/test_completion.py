"""Completion knows every command and option that help knows, and a shell completes with it."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from pica_command.catalogue import commands
from pica_command.completion import _flags
from pica_command.main import main

pytestmark = [pytest.mark.unit, pytest.mark.slow]

TRY = """
source "$1"; shift
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _pica; echo "${COMPREPLY[*]}"
"""


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("completion")


def script(folder: Path, shell: str, capsys: pytest.CaptureFixture[str]) -> Path:
    path = folder / shell
    if not path.exists():
        assert main(["completion", shell]) == 0
        path.write_text(capsys.readouterr().out)
    return path


@pytest.mark.parametrize("name", commands())
def test_completion_knows_the_options_that_help_knows(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*name.split("."), "--help"]) == 0
    lines = re.findall(r"^(?:│ |  )(-h, --.*|--[a-z].*)$", capsys.readouterr().out, re.MULTILINE)
    # A line is `--wait, --no-wait  Text` or `--size STR  Text`.
    heads = [re.split(r"  |[A-Z{]", line)[0] for line in lines]
    flags = {word.strip(",") for head in heads for word in head.split() if word[:2] == "--"}
    assert flags
    assert flags <= set(_flags(name))


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("vi", "view"),
        ("con", "config"),
        ("config sh", "show"),
        ("bench ca", "call"),
        ("view --layout ", "line arc table grid"),
        ("bench call --pe", "--peers"),
        ("avatar info sam --js", "--json"),
        ("relay --limits.joins-", "--limits.joins-per-s --limits.joins-burst"),
        ("relay --no-op", "--no-open-metrics"),
    ],
)
def test_bash_completes(
    scripts: Path, capsys: pytest.CaptureFixture[str], typed: str, offered: str
) -> None:
    bash = shutil.which("bash")
    assert bash is not None
    command = [bash, "-c", TRY, "try", script(scripts, "bash", capsys), "pica", *typed.split(" ")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == offered


def test_fish_and_zsh_get_the_same_words(scripts: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fish = script(scripts, "fish", capsys).read_text()
    line = "complete -c pica -n '__fish_use_subcommand' -a doctor -d 'Say what this machine can do"
    assert line in fish
    assert "-l layout -x -a 'line arc table grid'" in fish
    assert all(f"-a {name.rpartition('.')[2]} " in fish for name in commands())
    bash = script(scripts, "bash", capsys).read_text()
    assert script(scripts, "zsh", capsys).read_text().endswith(bash)
