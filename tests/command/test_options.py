"""Options from flags, variables and a TOML file, and one line for what is wrong in them."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal
from unittest.mock import patch

import pytest
from cyclopts import Parameter

from pica_command.options import CommandLine
from pica_command.table import COMMANDS, Command, UsageError

pytestmark = pytest.mark.unit


@dataclass(frozen=True, kw_only=True, slots=True)
class Pot:
    """A group of the example."""

    litres: float = 1.0
    """Its size."""
    lid: bool = True
    """With a lid."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Tea:
    """A group whose fields stand beside those of its owner."""

    cups: int = 2
    """Number of cups, 1 to 9."""
    pot: Pot = field(default_factory=Pot)

    def __post_init__(self) -> None:
        if not 1 <= self.cups <= 9:
            raise UsageError(f"--cups must be in 1..9, got {self.cups}")


@dataclass(frozen=True, kw_only=True, slots=True)
class TeaOptions:
    """Options of the example, with every kind of option."""

    kettle: Path | None = field(default=None, kw_only=False)
    """What boils the water."""
    tea: Annotated[Tea, Parameter(name="*")] = field(default_factory=Tea)
    leaf: Literal["green", "black"] = "green"
    """Which leaf."""
    name: str = ""
    """Whose tea."""
    clean: bool | None = None
    """Whether it is cleaned."""
    guests: tuple[str, ...] = ()
    """Names of the guests."""


def brew(options: TeaOptions) -> None:
    """Brew tea."""


class Brew(Command):
    """The example in the table."""

    def load(self) -> Any:
        return brew


BREW = Brew("", joins=True)


def read(*words: str, file: str | None = None, **environment: str) -> TeaOptions:
    line = CommandLine("brew", BREW, None if file is None else Path(file))
    with patch.dict(os.environ, environment):
        given = line.read(words)
    assert given is not None
    options: TeaOptions = given["options"]
    return options


@pytest.fixture(autouse=True)
def _brew_is_a_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(COMMANDS, "brew", BREW)


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], str]:
    def _write(text: str) -> str:
        path = tmp_path / "tea.toml"
        path.write_text(text)
        return str(path)

    return _write


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_file_is_read_as_notepad_and_powershell_write_it(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "tea.toml").write_text("[brew]\r\ncups = 3\r\n", encoding=encoding)
    assert read("kettle", "--config", str(tmp_path / "tea.toml")).tea.cups == 3


def test_flags_go_before_the_environment_that_before_the_file_that_before_defaults(
    write: Callable[[str], str],
) -> None:
    file = write('[brew]\ncups = 3\nleaf = "black"\nclean = true\n[brew.pot]\nlitres = 2\n')
    assert read(
        *("kettle", "--cups", "5", "--pot.no-lid", "--config", file),
        PICA_BREW_CUPS="4",
        PICA_BREW_POT_LITRES="3.5",
        PICA_BREW_POT_LID="true",
    ) == TeaOptions(
        kettle=Path("kettle"),
        tea=Tea(cups=5, pot=Pot(litres=3.5, lid=False)),
        leaf="black",
        clean=True,
    )


def test_commands_that_join_share_variables_and_keys(write: Callable[[str], str]) -> None:
    file = write('name = "Ada"\nroom = "attic"\n[send]\nfps = 3')
    assert read(file=file).name == "Ada"
    assert read(file=file, PICA_NAME="Bob", PICA_ROOM="attic").name == "Bob"
    assert read(file=file, PICA_NAME="Bob", PICA_BREW_NAME="Cyd").name == "Cyd"


@pytest.mark.parametrize(
    ("option", "text", "value"),
    [
        ("name", "a b", "a b"),
        ("kettle", "/a/b", Path("/a/b")),
        ("guests", "Ada Bob", ("Ada", "Bob")),
        ("clean", "no", False),
    ],
)
def test_a_variable_holds_every_kind(option: str, text: str, value: object) -> None:
    assert getattr(read(**{f"PICA_BREW_{option.upper()}": text}), option) == value


def test_a_list_is_several_words_and_a_list_of_the_file(write: Callable[[str], str]) -> None:
    wanted = ("Ada", "Bob")
    assert read("--guests", "Ada", "Bob", "--cups", "3").guests == wanted
    assert read(file=write('[brew]\nguests = ["Ada", "Bob"]')).guests == wanted


def test_a_file_name_in_the_file_is_found_beside_the_file(write: Callable[[str], str]) -> None:
    file = write('[brew]\nkettle = "red.kettle"')
    assert read(file=file).kettle == Path(file).parent / "red.kettle"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[brew]\ncups = 10", "cups must be in 1..9, got 10"),
        ("[brew]\ncups = true", '[brew][cups] from FILE: unable to convert "True" into int'),
        (
            '[brew]\nleaf = "mint"',
            'Invalid value "mint" for [brew][leaf] from FILE. Choose from: "green"',
        ),
        ("[brew.pot]\nlitre = 1", 'Unknown option: "[brew][pot][litre]" from FILE'),
        ("brew = 1", 'key [brew] in "FILE" must be a mapping'),
        ("[brwe]\ncups = 1", "FILE: unknown key brwe"),
        ("cups == 1", "FILE is not a TOML file: "),
        ("PICA_BREW_CUPS=ten", 'PICA_BREW_CUPS from env: unable to convert "ten" into int'),
        ("PICA_BREW_CUP=1", "unknown environment variable PICA_BREW_CUP"),
        ("--cups many", 'Invalid value for --cups: unable to convert "many" into int'),
        ("--cusp 5", "Unknown option: --cusp. Did you mean --cups?"),
        ("--leaf mint", 'Invalid value "mint" for --leaf. Choose from: "green", "black"'),
        ("--cups 2 kettle noise", "Unused Tokens: ['noise']"),
    ],
)
def test_what_is_wrong_in_a_file_a_variable_or_words_is_one_line_that_names_it(
    tmp_path: Path, text: str, complaint: str
) -> None:
    file, words, variables = tmp_path / "tea.toml", [], {}
    if text.startswith("PICA_"):
        variables = dict([text.split("=")])
    elif text.startswith("--"):
        words = text.split()
    else:
        file.write_text(text)
        words = ["--config", str(file)]
    with pytest.raises(UsageError) as caught:
        read(*words, **variables)
    assert complaint.replace("FILE", str(file)) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_help_is_there_whatever_file_and_environment_hold(
    capsys: pytest.CaptureFixture[str],
) -> None:
    line = CommandLine("brew", BREW, Path("nowhere.toml"))
    with patch.dict(os.environ, PICA_BREW_CUPS="ten"):
        assert line.read(["--help"]) is None
    assert "Number of cups, 1 to 9. [default: 2]" in capsys.readouterr().out
