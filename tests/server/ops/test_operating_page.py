"""The operators' page: its commands have options that exist, its numbers are those of the code."""

import re
import shlex
from dataclasses import fields
from pathlib import Path

import pytest
import tyro

from helpers.paths import ROOT
from helpers.relay_options import read_relay_options
from pica_client.cli.view import ViewOptions
from pica_command.settings import settings_of
from pica_protocol.errors import CloseCode
from pica_server.cli.relay import RelayOptions
from pica_server.cli.token import TokenOptions
from pica_server.config.relay import LimitsConfig

pytestmark = pytest.mark.unit

PAGE = (ROOT / "docs" / "operating.md").read_text()
COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    for line in block.splitlines()
    if line.startswith("pica ")
]
SETTINGS = {setting.flag: setting for setting in settings_of(RelayOptions)}


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_has_options_that_exist(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "relay.toml").write_text("room_capacity = 8\n")
    _, command, *words = shlex.split(line.partition(" > ")[0])
    if command == "relay":
        read_relay_options([word for word in words if word != "--print-config"], {})
    else:
        assert command == "token"
        tyro.cli(TokenOptions, args=words)


def test_every_limit_stands_on_the_page_with_its_default() -> None:
    for field in fields(LimitsConfig):
        assert f"`--limits.{field.name.replace('_', '-')}`" in PAGE
    options = read_relay_options([], {})
    rows = re.findall(r"^\| (`--[^|]+) \| ([^|]+) \| [^|]+ \| ([^|]+) \|([^|]*)\|$", PAGE, re.M)
    assert len(rows) == 11
    for flags, defaults, code, _ in rows:
        if code != "cut":
            CloseCode(int(code))
        for flag, default in zip(flags.split(", "), defaults.split(", "), strict=True):
            assert SETTINGS[flag.strip("`")].value_in(options) == float(default.removesuffix(" s"))


def test_every_flag_on_the_page_exists() -> None:
    known = {
        *SETTINGS,
        "--config",
        "--print-config",
        "--json",
        *(setting.flag for setting in settings_of(ViewOptions)),
    }
    known |= {f"--{field.name.replace('_', '-')}" for field in fields(TokenOptions)}
    spoken = re.findall(r"`(--[a-z.-]+)", PAGE)
    assert spoken
    assert set(spoken) <= {*known, "--profile"}


def test_the_three_ways_to_write_a_setting_are_one(tmp_path: Path) -> None:
    rows = re.findall(r"^\| `(--[^`]+)` \| `(PICA_[^`]+)` \| `([^`]+)`([^|]*) \|$", PAGE, re.M)
    assert len(rows) == 4
    for flag, variable, key, table in rows:
        file = tmp_path / "relay.toml"
        file.write_text(("[limits]\n" if "[limits]" in table else "") + key)
        name, _, value = variable.partition("=")
        one, two, three = (
            read_relay_options(shlex.split(flag), {}).config,
            read_relay_options([], {name: value}).config,
            read_relay_options(["--config", str(file)], {}).config,
        )
        assert one == two == three
