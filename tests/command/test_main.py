"""The dispatcher: what it finds, what it prints, what it ends with."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from pica_command.main import main
from pica_command.table import COMMANDS, GROUPS, Command, install_line, listing

pytestmark = pytest.mark.unit


@dataclass(frozen=True, kw_only=True, slots=True)
class GreetOptions:
    """Options of the example."""

    name: str = "you"
    """Whom to greet."""


class BadInputError(Exception):
    """An error of a user, as the packages mark it."""

    exit_code = 2


def greet(options: GreetOptions) -> dict[str, Any]:
    """Greet somebody."""
    if options.name == "nobody":
        raise BadInputError("name\x1bis 'nobody';\n   somebody is needed")
    if options.name == "crash":
        raise RuntimeError("a bug")
    wish, _, module = options.name.partition("-")
    if wish == "needs":
        raise ModuleNotFoundError(f"No module named {module!r}", name=module)
    if options.name == "missing":
        raise FileNotFoundError(2, "No such file or directory", "a.pica")
    if options.name == "interrupt":
        raise KeyboardInterrupt
    return {"greeting": f"hello {options.name}"}


class Greet(Command):
    """The example in the table."""

    def load(self) -> Any:
        return greet

    def summary(self) -> str:
        return "Greet somebody"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    for name in ("greet", "say greet"):
        monkeypatch.setitem(COMMANDS, name, Greet(""))
    monkeypatch.setitem(GROUPS, "Examples", {"greet": Greet(""), "say greet": Greet("")})
    return lambda *words: main(words)


def test_json_is_the_last_line_of_stdout(
    run: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("greet", "--name", "Ada", "--json") == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == {"greeting": "hello Ada"}


def test_half_a_command_ends_with_2_and_lists_its_family(
    run: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("say") == 2
    listed = capsys.readouterr().err
    assert re.search(r"^  say greet +Greet somebody$", listed, re.MULTILINE)
    assert "  greet " not in listed
    assert run("say", "--help") == 0
    assert capsys.readouterr().out == listed


@pytest.mark.parametrize(
    ("words", "kind", "code", "message"),
    [
        ("greet --name nobody", "bad_input", 2, "name\x1bis 'nobody'; somebody is needed"),
        ("greet --name missing", "file_not_found", 2, "No such file or directory: 'a.pica'"),
        ("greet --name needs-torch", "missing_extra", 2, install_line("train")),
        ("greet --name needs-numpy.linalg", "missing_extra", 2, install_line("send")),
        ("greet --name needs-av", "missing_extra", 2, install_line("video")),
        ("greet --name crash", "bug", 1, "a bug"),
        ("greet --name interrupt", "interrupted", 130, "stopped"),
        ("greet --nam Ada", "usage", 2, "Unknown option: --nam. Did you mean --name?"),
        ("geet", "usage", 2, "no command 'geet'; did you mean `pica greet`?"),
        ("say greed", "usage", 2, "no command 'say greed'; did you mean `pica say greet`?"),
        ("dance", "usage", 2, "no command 'dance'; `pica --help` lists all commands"),
    ],
)
def test_an_error_is_one_line_with_json_one_object_and_with_debug_a_traceback(
    run: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    words: str,
    kind: str,
    code: int,
    message: str,
) -> None:
    assert run(*words.split(), "--json") == code
    shown = capsys.readouterr()
    (line,) = shown.out.splitlines()
    error = json.loads(line)["error"]
    assert (error["kind"], error["exit_code"]) == (kind, code)
    assert error["message"].endswith(message)
    if kind == "bug":
        assert "RuntimeError: a bug" in shown.err
    else:
        assert shown.err == f"{error['command']}: {error['message']}\n".replace("\x1b", " ")
    assert run(*words.split(), "--debug") == code
    assert "Traceback" in capsys.readouterr().err


def test_the_list_has_a_line_for_every_command() -> None:
    text, width = listing(), max(map(len, COMMANDS)) + 2
    for name, row in COMMANDS.items():
        assert 10 <= len(row.summary()) <= 84, name
        assert f"  {name:{width}}{row.summary()}\n" in f"{text}\n"


RELAY = """
main(["--help"])
main(["relay", "--help"])
"""
SENDER = """
import importlib
for name in "cli.send cli.view cli.demo endpoint call.call".split():
    importlib.import_module(f"pica_client.{name}")
"""


@pytest.mark.parametrize(
    ("absent", "script"),
    [
        ("numpy torch moderngl", RELAY),
        ("torch moderngl glfw onnx onnxruntime PIL av cryptography", SENDER),
    ],
    ids=["a relay", "a sender"],
)
def test_nothing_is_imported_but_what_is_needed(absent: str, script: str) -> None:
    begin = f"import sys; sys.modules |= dict.fromkeys({absent.split()})"  # none can be imported
    code = f"{begin}\nfrom pica_command.main import main{script}"
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)
