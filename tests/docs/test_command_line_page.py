"""The page about the command line says what the command does."""

import json
import re

import pytest

from helpers.paths import ROOT, load_script
from pica_command.main import main

pytestmark = pytest.mark.unit

PAGE = (ROOT / "docs" / "command-line.md").read_text()


def test_the_page_is_what_its_script_writes() -> None:
    assert load_script("pages").command_line_page() == PAGE


def test_the_errors_on_the_page_are_what_the_command_says(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["veiw"]) == main(["send", "--nme", "Ada"]) == 2
    assert capsys.readouterr().err in PAGE
    shown = json.loads(re.search(r"^\{.*\}$", PAGE, re.MULTILINE)[0])["error"]  # type: ignore[index]  # it is there
    assert main(["send", "--url", "ws://127.0.0.1:9", "--json"]) == 2
    said = json.loads(capsys.readouterr().out)["error"]
    assert said.keys() == shown.keys()
    assert {**said, "message": ""} == {**shown, "message": ""}
