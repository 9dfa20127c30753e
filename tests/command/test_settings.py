import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import pytest
import tyro

from helpers.relay_options import read_relay_options
from pica_command.errors import UsageError
from pica_command.parsing import parse_words
from pica_command.profile import read_command
from pica_command.settings import Said, Setting, as_plain, as_toml, settings_of
from pica_server.cli.relay import RelayOptions
from pica_server.config.relay import LimitsConfig, RelayConfig
from pica_server.store.config import StoreConfig

pytestmark = pytest.mark.unit


@dataclass(frozen=True, kw_only=True, slots=True)
class Pot:
    """A group of the example."""

    litres: float = 1.0
    """How much."""
    lid: bool = True
    """Whether it has one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Tea:
    """An example with every kind of setting."""

    cups: int = 2
    """How many, 1 to 9."""
    leaf: Literal["green", "black"] = "green"
    """Which."""
    store: str = ""
    """Where from."""
    milk_token: str = ""
    """Needed for milk."""
    tin: Path | None = None
    """Where it is."""
    guests: tuple[str, ...] = ()
    """Who comes."""
    pot: Pot = field(default_factory=Pot)
    """What of."""

    def __post_init__(self) -> None:
        if not 1 <= self.cups <= 9:
            raise UsageError(f"--cups must be in 1..9, got {self.cups}")
        if len(self.guests) > self.cups:
            raise UsageError(f"--guests {len(self.guests)} are too many: raise --cups")


@dataclass(frozen=True, kw_only=True, slots=True)
class TeaOptions:
    """Options of the example."""

    tea: Annotated[Tea, tyro.conf.arg(name="")] = field(default_factory=Tea)
    """What to make."""
    OWN_FILE: ClassVar[bool] = True


def brew(*words: str, **environment: str) -> tuple[Tea, dict[str, str]]:
    tea, effective = brewed(words, environment)
    return tea, {setting.name: each.source for setting, each in effective.items()}


def brewed(words: Sequence[str], environment: Mapping[str, str]) -> tuple[Tea, dict[Setting, Said]]:
    def parse(words: Sequence[str]) -> TeaOptions:
        return parse_words(TeaOptions, words, prog="tea", description="")

    options, effective = read_command("tea", TeaOptions, words, environment, parse)
    return options.tea, effective


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], str]:
    def _write(text: str) -> str:
        path = tmp_path / "tea.toml"
        path.write_text(text)
        return str(path)

    return _write


def test_flags_go_before_the_environment_that_before_the_file_that_before_defaults(
    write: Callable[[str], str],
) -> None:
    file = write('cups = 3\nleaf = "black"\nstore = "file"\n[pot]\nlitres = 2\nlid = false\n')
    tea, sources = brew(
        "--cups", "5", "--pot.lid", "--config", file, PICA_TEA_CUPS="4", PICA_TEA_POT_LITRES="3.5"
    )
    assert tea == Tea(cups=5, leaf="black", store="file", pot=Pot(litres=3.5, lid=True))
    assert sources == {
        "cups": "--cups",
        "leaf": file,
        "store": file,
        "milk_token": "default",
        "tin": "default",
        "guests": "default",
        "pot.litres": "PICA_TEA_POT_LITRES",
        "pot.lid": "--pot.lid",
    }


def test_a_flag_that_says_no_is_a_flag(write: Callable[[str], str]) -> None:
    tea, sources = brew("--pot.no-lid", f"--config={write('[pot]' + chr(10) + 'lid = true')}")
    assert not tea.pot.lid
    assert sources["pot.lid"] == "--pot.lid"


def test_the_environment_may_name_the_file(write: Callable[[str], str]) -> None:
    assert brew(PICA_TEA_CONFIG=write("cups = 7"))[0].cups == 7


@pytest.mark.parametrize(
    ("variable", "text", "value"),
    [
        ("cups", "8", 8),
        ("leaf", "black", "black"),
        ("store", "a b", "a b"),
        ("tin", "/a/b", Path("/a/b")),
        ("guests", "Ada, Bob,", ("Ada", "Bob")),
        ("cups", "", 2),
    ],
)
def test_the_environment_holds_every_kind_and_empty_is_not_set(
    variable: str, text: str, value: object
) -> None:
    assert getattr(brew(**{f"PICA_TEA_{variable.upper()}": text})[0], variable) == value


@pytest.mark.parametrize("text", ["true", "Yes", "on", "1"])
def test_a_switch_in_the_environment_is_a_word(text: str) -> None:
    assert brew(PICA_TEA_POT_LID=text)[0].pot.lid
    assert not brew(PICA_TEA_POT_LID="off")[0].pot.lid


def test_a_file_name_in_the_file_is_found_beside_the_file(write: Callable[[str], str]) -> None:
    file = write('tin = "green.tin"')
    assert brew("--config", file)[0].tin == Path(file).parent / "green.tin"


def test_what_is_wrong_alone_may_be_right_together(write: Callable[[str], str]) -> None:
    file = write('guests = ["Ada", "Bob", "Cyd"]')
    with pytest.raises(UsageError, match=r"tea.toml: guests 3 are too many"):
        brew("--config", file)
    assert brew("--config", file, "--cups", "3")[0].cups == 3


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("cups = 10", "FILE: cups must be in 1..9, got 10"),
        ("cups = 2.0", "FILE: cups = 2.0 must be a whole number"),
        ("cups = true", "FILE: cups = true must be a whole number"),
        ('leaf = "mint"', 'FILE: leaf = "mint" must be one of green, black'),
        ("store = 3", "FILE: store = 3 must be text"),
        ("tin = []", "FILE: tin = [] must be the name of a file"),
        ('guests = "Ada"', 'FILE: guests = "Ada" must be a list of text, ["…", "…"]'),
        ("guests = [1]", 'FILE: guests = [1] must be a list of text, ["…", "…"]'),
        ("pot = 1", "FILE: pot must be a table, [pot]"),
        ('[pot]\nlid = "yes"', 'FILE: pot.lid = "yes" must be true or false'),
        ("[pot]\nlitre = 1", "FILE: unknown key pot.litre; did you mean pot.litres?"),
        ("coalesce_longest_s = 0", "FILE: unknown key coalesce_longest_s; this setting has gone"),
        ("cops = 1", "FILE: unknown key cops; did you mean cups?"),
        ("[spoon]\nlong = 1", "FILE: unknown key spoon"),
        ("cups == 1", "FILE: no TOML: "),
        ("cups = 1\x00", "FILE: no TOML: "),
    ],
)
def test_what_a_file_says_wrong_is_one_line_with_file_field_and_fix(
    write: Callable[[str], str], text: str, complaint: str
) -> None:
    file = write(text)
    with pytest.raises(UsageError) as caught:
        brew("--config", file)
    assert str(caught.value).startswith(complaint.replace("FILE", file))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_or_no_text_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nowhere\.toml: No such file"):
        brew("--config", "nowhere.toml")
    (tmp_path / "a.toml").write_bytes(b"cups = \xff")
    with pytest.raises(UsageError, match="no UTF-8 text at byte 7"):
        brew("--config", str(tmp_path / "a.toml"))


@pytest.mark.parametrize(
    ("variable", "text", "complaint"),
    [
        ("PICA_TEA_CUPS", "ten", "PICA_TEA_CUPS=ten must be a whole number"),
        ("PICA_TEA_CUPS", "10", "PICA_TEA_CUPS must be in 1..9, got 10"),
        (
            "PICA_TEA_CUPS",
            "tcp://10.0.0.1:80",
            "PICA_TEA_CUPS=tcp://10.0.0.1:80 must be a whole number; it ",
        ),
        ("PICA_TEA_LEAF", "mint", "PICA_TEA_LEAF=mint must be one of green, black"),
        ("PICA_TEA_POT_LID", "perhaps", "PICA_TEA_POT_LID=perhaps must be true or false"),
        ("PICA_TEA_POT_LITRES", "x" * 99, f"PICA_TEA_POT_LITRES={'x' * 57}... must be a number"),
        (
            "PICA_TEA_CUP",
            "1",
            "unknown environment variable PICA_TEA_CUP; did you mean PICA_TEA_CUPS?",
        ),
    ],
)
def test_what_the_environment_says_wrong_is_one_line(
    variable: str, text: str, complaint: str
) -> None:
    with pytest.raises(UsageError) as caught:
        brew(**{variable: text})
    assert str(caught.value).startswith(complaint)


def test_variables_of_others_are_not_ours() -> None:
    assert brew(HOME="/", TEAPOT="1")[0] == Tea()


def test_help_is_there_whatever_the_file_says(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        brew("--help", "--config", "nowhere.toml", PICA_TEA_CUPS="ten")
    assert "--cups" in capsys.readouterr().out


def test_what_is_printed_sets_the_same_again(write: Callable[[str], str]) -> None:
    tea, effective = brewed(("--guests", 'A"\\', "B\n", "--tin", "/a"), {"PICA_TEA_POT_LID": "no"})
    again, _ = brewed(("--config", write(as_toml(effective))), {})
    assert again == tea


def test_secrets_are_not_printed() -> None:
    secrets = ("--store", "s3://user:hunter2@host/x", "--milk-token", "hunter2")
    _, effective = brewed(secrets, {})
    text = as_toml(effective) + str(as_plain(effective))
    assert "hunter2" not in text
    assert 'store = "s3://***@host/x"  # --store' in text
    assert tomllib.loads(as_toml(effective))["milk_token"] == "***"


def test_every_setting_of_a_relay_has_a_place_in_file_and_environment() -> None:
    settings = settings_of(RelayOptions)
    names = {setting.name for setting in settings}
    assert {f.name for f in fields(RelayConfig)} - {"limits", "store"} <= names
    assert {f"limits.{f.name}" for f in fields(LimitsConfig)} <= names
    assert {f"store.{f.name}" for f in fields(StoreConfig)} <= names
    variables = {setting.variable("PICA_RELAY_") for setting in settings}
    assert len(variables) == len(settings)
    assert "PICA_RELAY_LIMITS_JOINS_PER_S" in variables


def test_a_field_that_fits_no_file_is_found_when_it_is_written() -> None:
    @dataclass
    class Odd:
        odd: Any = 1

    with pytest.raises(TypeError, match=r"Odd\.odd: "):
        settings_of(Odd)


def test_a_relay_reads_its_settings_from_all_three(write: Callable[[str], str]) -> None:
    words = ["--config", write("port = 1234\n[limits]\nburst_s = 4"), "--room-capacity", "5"]
    options = read_relay_options(words, {"PICA_RELAY_LIMITS_HANDSHAKES": "9"})
    limits = LimitsConfig(handshakes=9, burst_s=4)
    assert options.config == replace(RelayConfig(), port=1234, room_capacity=5, limits=limits)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--port", "many"], "Error parsing --port: invalid literal for int"),
        (["--prot", "5"], "Unrecognized options: --prot, 5; did you mean --port?"),
        (["--log", "xml"], "invalid choice 'xml' for argument '--log'. Expected one of "),
        (["--port"], "Missing value for argument '--port'"),
        (["noise"], "Unrecognized options: noise; `--help` lists all options"),
        (
            ["--coalesce-longest-s", "0"],
            "Unrecognized options: --coalesce-longest-s, 0; this setting has gone, leave it out",
        ),
    ],
)
def test_what_the_command_line_says_wrong_is_one_line(words: list[str], complaint: str) -> None:
    with pytest.raises(UsageError) as caught:
        read_relay_options(words, {})
    assert str(caught.value).startswith(complaint)
    assert "\n" not in str(caught.value)
