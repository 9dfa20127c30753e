"""What help says of every command: groups, one line each, and nothing that programmers leave."""

from __future__ import annotations

import re

import pytest

from pica_command.catalogue import GROUPS, OTHERS, commands, listing, summary
from pica_command.main import main

pytestmark = [pytest.mark.unit, pytest.mark.slow]

COMMANDS = commands()


def test_the_list_has_a_heading_and_a_line_for_every_command() -> None:
    text = listing(COMMANDS)
    for name, entry in COMMANDS.items():
        said = summary(entry)
        assert 10 <= len(said) <= 84, name
        assert re.search(rf"^  {name.replace('.', ' ')}  +{re.escape(said)}$", text, re.MULTILINE)
    assert all(f"\n{heading}:\n" in text for heading in GROUPS)
    assert f"\n{OTHERS}:\n" not in text


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command_has_no_leftovers_of_the_code(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*name.split("."), "--help"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"usage: pica {name.replace('.', ' ')} ")
    for leftover in ("``", "Raises:", "Returns:", "Args:", "{None}", "default: None"):
        assert leftover not in said
